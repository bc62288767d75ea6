# SPDX-License-Identifier: MIT
"""Fits surfels to posed images of an object whose mesh is known."""

import hashlib
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
import trimesh
from torch import Tensor

from pinwm_drake.checkpoints import check_arrays, read_arrays, write_arrays
from pinwm_drake.errors import InputError, RenderingError
from pinwm_drake.geometry.meshes import half_diagonal
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.densify import densify
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.fit_state import CAMERA, SURFEL, FitState
from pinwm_drake.rendering.initial import initial_surfels
from pinwm_drake.rendering.losses import SsimTarget, distortion_loss, normal_consistency, photometric
from pinwm_drake.rendering.render import Rendering, render
from pinwm_drake.rendering.silhouette import between_views, coverage
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.rendering.views import View, box_around
from pinwm_drake.spatial.poses import transform
from pinwm_drake.spatial.rotations import quaternion_to_matrix
from pinwm_drake.threads import available, one_torch_thread

CHECKPOINT_FILE = "checkpoint.npz"
_VERSION = 1
# These may change between a fit and its continuation.
_FREE = ("checkpoint_every",)
_ROWS: tuple[str, tuple[int | None, ...]] = ("f", (None, 3))
_TESTS: tuple[str, tuple[int | None, ...]] = ("f", (None, 2))

Progress = Callable[[int, int, float, float | None, int], None]
Now = Callable[[], tuple[Surfels, tuple[float, float]]]
"""Function that gives the surfels of this moment, and the offset of the principal point [px]."""

_MOST_FINER = 8  # times, a side, that a small image is rendered finer
# An image that is met exactly has no PSNR; this one stands for it, dB.
_MOST_PSNR = 100.0


@dataclass(frozen=True, eq=False)
class History:
    """History of a fit, iteration by iteration."""

    iteration: np.ndarray  # (n,) int64, counted from 1
    loss: np.ndarray  # (n,) float64
    psnr: np.ndarray  # (n,) float64, PSNR of that iteration's view over its whole image, dB
    num_surfels: np.ndarray  # (n,) int64
    test_iteration: np.ndarray  # (m,) int64, iterations after which the held-out views were measured
    test_psnr: np.ndarray  # (m,) float64, their mean PSNR, dB


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of a fit: surfels, history and quality.

    Attributes:
        surfels: surfels in O, with harmonics of the chosen degree.
        history: course of the fit.
        psnr_train: PSNR of each view that was fitted, by its name, over the whole image, dB.
        psnr_test: PSNR of each held-out view, by its name, over the whole image, dB.
        camera_offset: offset that was added to cx and cy of every view, px; 0 unless rate_camera is positive.
        seconds: wall time, that of interrupted parts included.
    """

    surfels: Surfels
    history: History
    psnr_train: dict[str, float]
    psnr_test: dict[str, float]
    camera_offset: tuple[float, float]
    seconds: float


def fit(
    views: Sequence[View],
    mesh: trimesh.Trimesh,
    options: FitOptions | None = None,
    *,
    folder: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    watch: Callable[[Now], None] | None = None,
) -> FitResult:
    """Fits surfels to views, starting on the surface of the mesh.

    Each iteration renders the surroundings of the object in one view and steps along the gradient of
    (1 - lambda) L_1 + lambda L_D-SSIM + w_d L_d + w_n L_n. Every other one also compares the opacity with the outline
    of the mesh from a pose near that of the view, which no image shows. And one offset of the principal point is learnt
    for all views, as half a pixel is easily lost between two conventions.

    Args:
        views: views of the object, at least one that is not held out.
        mesh: the object's surface in O, m.
        options: None for the defaults.
        folder: existing folder for checkpoints; None for none.
        resume: go on from the folder's checkpoint, if there is one. The result is the same, bit for bit, as that of a
            fit that was not interrupted.
        progress: called after every iteration with its number from 1, the number of iterations, the loss, the mean PSNR
            of the held-out views when last measured (dB, None before that), and the number of surfels.
        watch: called after `progress` with a function that gives the present surfels, which no step changes any more.

    Returns:
        The surfels and how good they are.

    Raises:
        RenderingError: views and mesh do not fit together.
        InputError: the checkpoint cannot be written or read, or is of another fit.

    Source:
        PIN-WM (Li et al., 2025), eq. 7; Huang et al. (2024), section 5; Kerbl et al. (2023), section 5.
    """
    options = options or FitOptions()
    if resume and folder is None:
        raise RenderingError("resume needs the folder of the checkpoint; allowed: folder=..., or resume=False")
    if folder is not None and not folder.is_dir():
        raise InputError(folder, value="no such folder", allowed="an existing folder for checkpoints")
    test = [view for i, view in enumerate(views) if options.held_out and i % options.held_out == options.held_out - 1]
    train = [view for view in views if not any(view is other for other in test)]
    if not train:
        raise RenderingError(
            f"fit got {len(views)} views, of which {len(test)} are held out; allowed: 1 or more to fit"
        )
    threads = options.num_threads or available()
    with one_torch_thread():
        return _Fit(train, test, mesh, options, threads, folder, _describe(views, mesh, options, threads)).run(
            resume, progress, watch
        )


def finer_by(views: Sequence[View]) -> dict[str, int]:
    """How many times finer the views of a fit are rendered, a side, by their names: 1, and more for small images.

    A pixel of a small image is the mean of what it covers, which several pixels of a large one show. A rendering has
    one ray in each pixel: at the size of the small image it would spoil detail that large images show.
    """
    lengths = {view.name: float(view.camera.intrinsics[:2].double().prod().sqrt()) for view in views}
    return {name: min(round(max(lengths.values()) / length), _MOST_FINER) for name, length in lengths.items()}


def pooled(color: Tensor, finer: int) -> Tensor:
    """Means (H, W, 3) of the squares of `finer` x `finer` pixels of an image (finer H, finer W, 3)."""
    if finer == 1:
        return color
    H, W = color.shape[0] // finer, color.shape[1] // finer
    return color.reshape(H, finer, W, finer, 3).mean((1, 3))


def psnr(mean_square: float) -> float:
    """Peak signal-to-noise ratio in dB of images with a mean squared difference; 100 for equal ones."""
    return min(-10.0 * float(np.log10(mean_square)), _MOST_PSNR) if mean_square > 0.0 else _MOST_PSNR


def _describe(views: Sequence[View], mesh: trimesh.Trimesh, options: FitOptions, threads: int) -> dict[str, object]:
    """Return the description of a fit's inputs: its options, and the hash of its views and mesh."""
    digest = hashlib.sha256()
    for view in views:
        digest.update(f"{view.name} {view.camera.width} {view.camera.height}".encode())
        for tensor in (view.camera.intrinsics, view.X_CO.q, view.X_CO.p, view.image, view.mask):
            digest.update(tensor.numpy().tobytes())
    digest.update(np.asarray(mesh.vertices, float).tobytes())
    digest.update(np.asarray(mesh.faces, np.int64).tobytes())
    kept = {name: value for name, value in asdict(options).items() if name not in _FREE}
    return {"version": _VERSION, "views and mesh": digest.hexdigest(), **kept, "num_threads": threads}


class _Target:
    """The box around the object in a view, at one size, and what the loss needs of it."""

    def __init__(self, view: View, corners: Tensor, margin: int, factor: float, num_threads: int, finer: int) -> None:
        box = view.object_box(corners, margin)
        self.view = view.cropped(*box)
        # Outside its box an image is taken to be met exactly, which matters for the PSNR on the way only.
        self.share = box[2] * box[3] / (view.camera.width * view.camera.height)
        if factor < 1.0:
            self.view = self.view.scaled(factor)
        self.factor, self.camera, self.finer = factor, view.camera, finer
        self.R_CO = quaternion_to_matrix(view.X_CO.q).float()
        self.p_CO = view.X_CO.p.float()
        self.ssim = SsimTarget(self.view.image, num_threads)


class _Fit:
    """Course of one fit: targets, state, and the rows of its history."""

    def __init__(
        self,
        train: list[View],
        test: list[View],
        mesh: trimesh.Trimesh,
        options: FitOptions,
        threads: int,
        folder: Path | None,
        about: dict[str, object],
    ) -> None:
        self.train, self.test, self.mesh, self.options = train, test, mesh, options
        self.threads, self.folder, self.about = threads, folder, about
        corners = self.corners = torch.from_numpy(np.array(mesh.vertices))
        self.radius = half_diagonal(mesh)
        margin = options.margin
        self.finer = finer_by(train + test)
        if small := sum(finer > 1 for finer in self.finer.values()):
            total = len(self.finer)
            words = f"{small} of {total} images are small, which costs quality; use images of one size"
            warnings.warn(words, stacklevel=2)
        self.targets = {
            factor: [_Target(view, corners, margin, factor, threads, self.finer[view.name]) for view in train]
            for factor in ((1.0, 0.5) if options.coarse > 0.0 else (1.0,))
        }
        middles = [view.project(corners)[1].mean() / view.camera.intrinsics[0] for view in train]
        self.pixel = float(torch.stack(middles).median())  # m, on the object
        first = initial_surfels(
            mesh,
            train,
            options.first_surfels or max(int(0.6 * options.max_surfels), 1),
            degree=options.sh_degree,
            crease_share=options.crease_share,
            seed=options.seed,
            num_threads=threads,
        )
        self.state = FitState(first, options, self.radius)
        self.iteration, self.seconds = 0, 0.0
        self.rows: list[tuple[float, float, float]] = []  # loss, PSNR, number of surfels
        self.tests: list[tuple[float, float]] = []  # iteration, PSNR

    def run(self, resume: bool, progress: Progress | None, watch: Callable[[Now], None] | None) -> FitResult:
        options = self.options
        if resume and self.folder is not None:
            self._restore(read_arrays(self.folder / CHECKPOINT_FILE, self.about, "fit", self._arrays()))
        started = time.perf_counter() - self.seconds
        while self.iteration < options.iterations:
            loss, value = self._iterate(self.iteration)
            self.iteration += 1
            if options.densifies(self.iteration):
                densify(self.state, options, self.pixel)
            self.rows.append((loss, value, self.state.num_surfels))
            every = options.evaluate_every
            if self.test and (self.iteration == options.iterations or (every and self.iteration % every == 0)):
                self.tests.append((self.iteration, float(np.mean(list(self._measure(self.test).values())))))
            if progress is not None:
                measured = self.tests[-1][1] if self.tests else None
                progress(self.iteration, options.iterations, loss, measured, self.state.num_surfels)
            if watch is not None:
                watch(self._now)
            if self.folder is not None and (
                self.iteration % options.checkpoint_every == 0 or self.iteration == options.iterations
            ):
                self.seconds = time.perf_counter() - started
                arrays = {name: value.numpy() for name, value in self._arrays().items()}
                write_arrays(self.folder / CHECKPOINT_FILE, self.about, arrays)
        self.seconds = time.perf_counter() - started
        return self._result()

    def _iterate(self, iteration: int) -> tuple[float, float]:
        """One step of the optimiser; the loss, and the view's PSNR."""
        options, state = self.options, self.state
        target = self._target(iteration)
        surfels = state.surfels(options.degree(iteration))
        full = iteration % options.geometry_every == 0 and (options.distortion > 0.0 or options.normal > 0.0)
        camera = self._shifted(target.view.camera, target.factor)
        finer = camera.scaled(target.finer)
        rendering = self._render(surfels, finer, target.view, full)
        color = pooled(rendering.color[0], target.finer)
        loss = photometric(color, target.ssim, kind=options.photometric, dssim=options.dssim)
        total = loss
        if full:
            spread = distortion_loss(rendering, self.radius) if options.distortion > 0.0 else 0.0
            bent = normal_consistency(rendering, finer) if options.normal > 0.0 else 0.0
            total = loss + options.geometry_every * (options.distortion * spread + options.normal * bent)
        total.backward()
        self._watch(target, camera)
        if options.silhouette > 0.0 and iteration % options.silhouette_every == 0:
            (options.silhouette * self._outline_loss(iteration, target, state.surfels(0))).backward()
        state.step(options.rate(iteration))
        with torch.no_grad():
            square = float((color - target.view.image).square().mean())
        return float(loss.detach()), psnr(square * target.share)

    def _target(self, iteration: int) -> "_Target":
        """Return the view of an iteration: every view once, in an order of its own, then again."""
        epoch, position = divmod(iteration, len(self.train))
        order = np.random.default_rng([self.options.seed, epoch]).permutation(len(self.train))
        factor = 0.5 if iteration < self.options.coarse * self.options.iterations else 1.0
        return self.targets[factor][order[position]]

    def _outline_loss(self, iteration: int, target: "_Target", surfels: Surfels) -> Tensor:
        """Loss of the outline: difference of opacity and outline of the mesh, from a pose near that of the target."""
        generator = np.random.default_rng([self.options.seed, 1, iteration])
        X_CO = between_views(self.mesh, target.view.X_CO, self.options.silhouette_spread, generator)
        if not bool((transform(X_CO, self.corners)[:, 2] > 0.0).all()):
            return surfels.logit_opacity.sum() * 0.0  # the camera is next to the object, and now inside
        whole = target.camera.scaled(target.factor)
        camera = whole.cropped(*box_around(whole, X_CO, self.corners, self.options.margin))
        rendering = render(surfels, camera, X_CO, full=False, backend=self.options.backend, num_threads=self.threads)
        return (rendering.alpha[0] - coverage(self.mesh, camera, X_CO)).abs().mean()

    def _shifted(self, camera: Camera, factor: float = 1.0) -> Camera:
        """Return the camera with the principal point that was learnt, which is counted in px of the whole image."""
        if self.options.rate_camera == 0.0:
            return camera
        x, y = (factor * self.state.tensors[CAMERA].detach()).tolist()
        return camera.shifted((x, y))

    def _render(self, surfels: Surfels, camera: Camera, view: View, full: bool) -> Rendering:
        return render(surfels, camera, view.X_CO, full=full, backend=self.options.backend, num_threads=self.threads)

    @torch.no_grad()
    def _watch(self, target: "_Target", camera: Camera) -> None:
        """Screen gradients, of the surfels for densification and their sum, which is that of the principal point."""
        p_OS = self.state.tensors["p_OS"]
        assert p_OS.grad is not None
        z = (p_OS @ target.R_CO[2] + target.p_CO[2])[:, None]
        # px of the whole image: moving by one pixel there moves by `factor` here.
        per_pixel = z / camera.intrinsics[:2].float() * target.factor
        screen = (p_OS.grad @ target.R_CO[:2].T) * per_pixel
        self.state.watch(screen)
        if self.options.rate_camera > 0.0:
            self.state.tensors[CAMERA].grad = screen.sum(0)

    @torch.no_grad()
    def _measure(self, views: list[View]) -> dict[str, float]:
        """PSNR of whole images, by the names of their views, dB."""
        surfels = self.state.surfels(self.options.degree(max(self.iteration - 1, 0)))
        found = {}
        for view in views:
            finer = self.finer[view.name]
            camera = self._shifted(view.camera).scaled(finer)
            color = pooled(self._render(surfels, camera, view, False).color[0], finer)
            found[view.name] = psnr(float((color - view.image).square().mean(dtype=torch.float64)))
        return found

    def _arrays(self) -> dict[str, Tensor]:
        return self.state.arrays() | {
            "iteration": torch.tensor(self.iteration),
            "seconds": torch.tensor(self.seconds, dtype=torch.float64),
            "rows": torch.tensor(self.rows, dtype=torch.float64).reshape(-1, 3),
            "tests": torch.tensor(self.tests, dtype=torch.float64).reshape(-1, 2),
        }

    def _restore(self, arrays: dict[str, np.ndarray] | None) -> None:
        if arrays is None or self.folder is None:
            return
        self._check(self.folder / CHECKPOINT_FILE, arrays)
        self.state.restore({name: torch.from_numpy(value) for name, value in arrays.items()})
        self.iteration, self.seconds = int(arrays["iteration"]), float(arrays["seconds"])
        self.rows = [tuple(row) for row in arrays["rows"].tolist()]
        self.tests = [tuple(row) for row in arrays["tests"].tolist()]

    def _check(self, path: Path, arrays: dict[str, np.ndarray]) -> None:
        """Raise InputError where arrays of a checkpoint do not fit the options, or each other."""
        options, N = self.options, len(np.atleast_1d(arrays["tensor.p_OS"]))
        per_surfel = {f"{kind}.{name}" for kind in ("tensor", "first", "second") for name in SURFEL}
        wanted: dict[str, tuple[str, tuple[int | None, ...]]] = {}
        for name, value in self._arrays().items():
            each = name in per_surfel or name in ("screen", "counts")
            wanted[name] = ("f", (N, *value.shape[1:]) if each else tuple(value.shape))
        check_arrays(path, arrays, wanted | {"iteration": ("i", ())} | {"rows": _ROWS, "tests": _TESTS}, "fit")
        iteration, rows = int(arrays["iteration"]), arrays["rows"]
        every, seen = options.evaluate_every, arrays["tests"][:, 0].tolist() if self.test else []
        measured = [k for k in range(1, iteration + 1) if (every and k % every == 0) or k == options.iterations]
        if not 1 <= iteration <= options.iterations or len(rows) != iteration or (self.test and seen != measured):
            found = f"iteration {iteration} with {len(rows)} rows, {len(seen)} tests"
            raise InputError(path, value=found, allowed=f"1 to {options.iterations}, with a row for each")
        least = min(float(arrays[f"second.{name}"].min(initial=0.0)) for name in (*SURFEL, CAMERA))
        if not 1 <= N <= options.max_surfels or rows[-1, 2] != N or least < 0.0:
            found = f"{N} surfels, where its last row has {rows[-1, 2]:g}"
            raise InputError(path, value=found, allowed=f"one number of surfels, 1 to {options.max_surfels}")

    def _now(self) -> tuple[Surfels, tuple[float, float]]:
        """Surfels of this moment, with harmonics of the final degree, and the camera's offset [px]."""
        x, y = self.state.tensors[CAMERA].detach().tolist()
        surfels = self.state.surfels(self.options.sh_degree).detach()
        return replace(surfels, q_OS=torch.nn.functional.normalize(surfels.q_OS, dim=-1)), (x, y)

    def _result(self) -> FitResult:
        rows, tests = np.array(self.rows).reshape(-1, 3), np.array(self.tests).reshape(-1, 2)
        history = History(
            iteration=np.arange(1, len(rows) + 1),
            loss=rows[:, 0],
            psnr=rows[:, 1],
            num_surfels=rows[:, 2].astype(np.int64),
            test_iteration=tests[:, 0].astype(np.int64),
            test_psnr=tests[:, 1],
        )
        surfels, offset = self._now()
        return FitResult(
            surfels=surfels,
            history=history,
            psnr_train=self._measure(self.train),
            psnr_test=self._measure(self.test),
            camera_offset=offset,
            seconds=self.seconds,
        )
