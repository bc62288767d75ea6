# SPDX-License-Identifier: MIT
"""The adjustment: one least-squares problem of a lens, of poses and of the board's scale, with all photos.

A photo sees corners p_C = A_1 A_2 ... A_K s p_M through the lens, where each A_k is a constant, an unknown pose or the
inverse of one, and s is the board's scale. A pose is changed by small motions X <- X (Exp(w), v), of which some of the
six may be free. Poses that a robot told have its noise. The three noises (pixels, robot's places, robot's turns) are
estimated with the unknowns.

SciPy's `least_squares` factors the whole Jacobian at each step, and weighs each residual alone. Here the two numbers
of a corner, and the six of a pose, are weighed together.

Source: W. Förstner and B. Wrobel, "Photogrammetric Computer Vision" (2016), section 4.2.4, for the variance components.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular

from pinwm_drake.capture.lens import Lens
from pinwm_drake.errors import SolverError
from pinwm_drake.spatial.rigid import apply, cross, inverse, rigid, turn

ALL = tuple(range(6))  # v_x, v_y, v_z, w_x, w_y, w_z
# Standard deviations of what is known of a lens before: cx, cy as a share of the width, and the distortion.
_CENTRE = 0.05
_DISTORTION = {"opencv": (1.0, 2.0, 0.05, 0.05, 2.0), "fisheye": (0.5, 0.5, 0.5, 0.5)}
_CORNER_SCALE, _ROBOT_SCALE = 3.0, 4.0  # standard deviations, where the robust weight is one half
_ALIKE = 20.0  # weight, in residuals, of all photos in the noise of one
_STEPS, _SMALL = 50, 1e-8  # steps of an adjustment, and the relative change of the loss that ends it
_MOST_DAMPING = 1e8


@dataclass(eq=False)
class Block:
    """Unknown pose of the adjustment.

    Attributes:
        X: (4, 4), the present value.
        free: Numbers of the motions that are free: v_x, v_y, v_z, w_x, w_y, w_z.
        told: (4, 4), value that the robot told; None where it told none.
        trusted: Flag: the told value is no outlier.
        at: Number of its first unknown.
    """

    X: np.ndarray
    free: tuple[int, ...] = ALL
    told: np.ndarray | None = None
    trusted: bool = True
    at: int = 0

    @property
    def columns(self) -> slice:
        """Columns of its unknowns in the Jacobian."""
        return slice(self.at, self.at + len(self.free))

    def error(self) -> np.ndarray:
        """Motion (6,) [m, rad] from the told pose to the present one."""
        assert self.told is not None
        D = inverse(self.told) @ self.X
        return np.concatenate([D[:3, 3], turn(D)])


@dataclass(frozen=True, eq=False)
class Link:
    """Factor of a chain: an unknown pose, or its inverse; or a constant (4, 4)."""

    block: Block | None
    constant: np.ndarray | None = None
    inverted: bool = False

    @property
    def X(self) -> np.ndarray:
        """Present value, (4, 4)."""
        if self.block is None:
            assert self.constant is not None
            return self.constant
        return inverse(self.block.X) if self.inverted else self.block.X


@dataclass(eq=False)
class Photo:
    """Corners in a photo, with the chain from the camera to the board.

    Attributes:
        name: Name of the file, from the lab's folder.
        p_M: (n, 3) m, corners as the board has them at scale 1.
        pixels: (n, 2) px, where they were found.
        chain: Factors of X_CM.
        kept: (n,) bool: corners that are no outliers.
        blur: Noise of its corners, relative to that of all photos: more in small, oblique or blurred boards.
    """

    name: str
    p_M: np.ndarray
    pixels: np.ndarray
    chain: tuple[Link, ...]
    kept: np.ndarray = field(default_factory=lambda: np.ones(0, bool))
    blur: float = 1.0

    def __post_init__(self) -> None:
        self.kept = np.ones(len(self.p_M), bool)

    @property
    def X_CM(self) -> np.ndarray:
        """Present pose of the board in the camera, (4, 4)."""
        X = np.eye(4)
        for link in self.chain:
            X = X @ link.X
        return X


@dataclass(eq=False)
class Noise:
    """Standard deviations of what was measured, on each axis: px, m and rad."""

    pixel: float
    place: float = 1e-3
    angle: float = 1e-3

    def values(self) -> np.ndarray:
        """Return the three numbers."""
        return np.array([self.pixel, self.place, self.angle])


_LEAST = Noise(0.01, 1e-5, 2e-5).values()


@dataclass(frozen=True, eq=False)
class System:
    """Whitened residuals r (m,) and Jacobian J (m, n) at the present values.

    Rows are grouped: 0 for pixels, 1 and 2 for the robot's places and turns, 3 for what is known before.
    """

    r: np.ndarray
    J: np.ndarray
    group: np.ndarray
    photo: np.ndarray  # (m,) number of the photo, or -1

    def normal(self) -> np.ndarray:
        """Normal matrix (n, n)."""
        return self.J.T @ self.J


class Bundle:
    """Least-squares problem of all photos.

    Args:
        lens: First guess.
        photos: The photos; unknown poses are those that their chains name.
        noise: First guess.
        scale_noise: Standard deviation of the board's scale, which is 1; None where the scale is exact.

    Attributes:
        lens, scale, photos, noise: Present values.
        blocks: The unknown poses.
        size: Number of unknowns: lens, scale, poses.
    """

    def __init__(self, lens: Lens, photos: Sequence[Photo], noise: Noise, scale_noise: float | None = None) -> None:
        self.lens, self.photos, self.noise, self.scale, self._scale_noise = lens, list(photos), noise, 1.0, scale_noise
        self.num_lens = len(lens.parameters)
        self.blocks: list[Block] = []
        at = self.num_lens + 1
        for photo in self.photos:
            for link in photo.chain:
                if link.block is not None and not any(link.block is one for one in self.blocks):
                    link.block.at = at
                    at += len(link.block.free)
                    self.blocks.append(link.block)
        self.size = at
        middle = np.array([0.5 * lens.width, 0.5 * lens.height])
        self._known = np.concatenate([middle, np.zeros(len(lens.distortion))])
        self._spread = np.array([_CENTRE * lens.width] * 2 + list(_DISTORTION[lens.model]))

    @property
    def told(self) -> list[Block]:
        """Poses that the robot told, in the order of the photos."""
        return [block for block in self.blocks if block.told is not None]

    def pixel_errors(self, photo: Photo) -> np.ndarray:
        """Residuals (n, 2) [px] of a photo: where a corner was found, less where it should be."""
        return photo.pixels - self.lens.project(apply(photo.X_CM, self.scale * photo.p_M))

    def system(self, robust: bool = False) -> System:
        """Whitened residuals and Jacobian at the present values; with robust weights if asked for."""
        rows: list[tuple[np.ndarray, np.ndarray, int, int]] = []
        for number, photo in enumerate(self.photos):
            if photo.kept.any():
                r, J = self._see(photo)
                rows.append((*_weighted(r, J, 2, _CORNER_SCALE if robust else None), 0, number))
        for block in self.blocks:
            if block.told is not None and block.trusted:
                rows += self._told(block, robust)
        J = np.zeros((len(self._known), self.size))
        J[:, 2 : self.num_lens] = np.diag(1.0 / self._spread)
        rows.append(((self.lens.parameters[2:] - self._known) / self._spread, J, 3, -1))
        J = np.zeros((1, self.size))
        J[0, self.num_lens] = 1.0 / (self._scale_noise or 1e-9)
        rows.append((np.array([self.scale - 1.0]) * J[0, self.num_lens], J, 3, -1))
        lengths = [len(r) for r, _, _, _ in rows]
        return System(
            np.concatenate([r for r, _, _, _ in rows]),
            np.concatenate([J for _, J, _, _ in rows]),
            np.repeat([group for _, _, group, _ in rows], lengths),
            np.repeat([photo for _, _, _, photo in rows], lengths),
        )

    def _see(self, photo: Photo) -> tuple[np.ndarray, np.ndarray]:
        """Whitened residuals and Jacobian of the corners that are kept: where they should be less where they are."""
        p_M = photo.p_M[photo.kept]
        links = [link.X for link in photo.chain]
        points = [self.scale * p_M]  # before each factor, from the last one on
        for X in reversed(links):
            points.append(apply(X, points[-1]))
        p_C = points[-1]
        pixels, by_point, by_lens = self.lens.project_with_jacobian(p_C)
        J = np.zeros((len(p_M), 2, self.size))
        J[:, :, : self.num_lens] = by_lens
        R = np.eye(3)
        for link, X, before, after in zip(photo.chain, links, points[-2::-1], points[:0:-1], strict=True):
            if link.block is not None:
                if link.inverted:
                    by_v, by_w = np.broadcast_to(-R, (len(p_M), 3, 3)), R @ cross(after)
                else:
                    turned = R @ X[:3, :3]
                    by_v, by_w = np.broadcast_to(turned, (len(p_M), 3, 3)), -turned @ cross(before)
                motions = np.concatenate([by_v, by_w], -1)[..., list(link.block.free)]
                J[:, :, link.block.columns] += by_point @ motions
            R = R @ X[:3, :3]
        J[:, :, self.num_lens] = (by_point @ (p_M @ R.T)[..., None])[..., 0]
        spread = photo.blur * self.noise.pixel
        return (pixels - photo.pixels[photo.kept]).ravel() / spread, J.reshape(-1, self.size) / spread

    def _told(self, block: Block, robust: bool) -> list[tuple[np.ndarray, np.ndarray, int, int]]:
        """Rows of a pose that the robot told, weighted together."""
        error, J = block.error(), np.zeros((6, self.size))
        # For turns of a degree the derivative of the rotation vector is 1 to within 1e-4.
        own = np.eye(6)
        own[:3, :3] = rigid(w=error[3:])[:3, :3]
        J[:, block.columns] = own[:, list(block.free)]
        spread = np.repeat([self.noise.place, self.noise.angle], 3)
        r, J = _weighted(error / spread, J / spread[:, None], 6, _ROBOT_SCALE if robust else None)
        return [(r[:3], J[:3], 1, -1), (r[3:], J[3:], 2, -1)]

    def adjust(self, robust: bool = False) -> None:
        """Find the least-squares solution near the present values, at the present noises.

        Raises:
            SolverError: The problem leaves an unknown open.
        """
        damping, system = 1e-4, self.system(robust)
        loss = self._loss(system, robust)
        for _ in range(_STEPS):
            normal, gradient = system.normal(), system.J.T @ system.r
            if not np.isfinite(normal).all():
                raise SolverError("the calibration does not converge: no finite residuals")
            while damping < _MOST_DAMPING:
                step = _solve(normal + damping * np.diag(np.diag(normal)), -gradient)
                undo = self._move(step)
                trial = self.system(robust)
                trial_loss = self._loss(trial, robust)
                if trial_loss <= loss:
                    break
                undo()
                damping *= 10.0
            else:
                return
            change, loss, system, damping = loss - trial_loss, trial_loss, trial, max(0.1 * damping, 1e-12)
            if change <= _SMALL * loss:
                return

    def _loss(self, system: System, robust: bool) -> float:
        if not robust:
            return float(system.r @ system.r)
        # Weights w = 1 / (1 + d^2/c^2) have been applied: r^2 = w d^2, whose loss is c^2 log(1 + d^2/c^2).
        total = 0.0
        for group, width, scale in ((0, 2, _CORNER_SCALE), (None, 6, _ROBOT_SCALE)):
            rows = system.group == 0 if group == 0 else (system.group == 1) | (system.group == 2)
            square = (system.r[rows].reshape(-1, width) ** 2).sum(1)
            total += float((scale**2 * -np.log1p(-np.minimum(square / scale**2, 1.0 - 1e-12))).sum())
        rest = system.r[system.group == 3]
        return total + float(rest @ rest)

    def _move(self, step: np.ndarray) -> "_Undo":
        undo = _Undo(self)
        with np.errstate(over="ignore"):
            parameters = self.lens.parameters + step[: self.num_lens]
        parameters[:2] = np.maximum(parameters[:2], 0.1 * self.lens.intrinsics[:2])
        self.lens = self.lens.with_parameters(parameters)
        self.scale += float(step[self.num_lens])
        for block in self.blocks:
            motion = np.zeros(6)
            motion[list(block.free)] = step[block.columns]
            block.X = block.X @ rigid(motion[:3], motion[3:])
        return undo

    def covariance(self, system: System | None = None) -> np.ndarray:
        """Covariance (n, n) of the unknowns at the present values and noises.

        Raises:
            SolverError: The photos leave an unknown open.
        """
        normal = (system or self.system()).normal()
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        try:
            L = cholesky(normal * scale[:, None] * scale, lower=True)
        except np.linalg.LinAlgError as error:
            raise SolverError("the photos leave part of the calibration open: take more, from other sides") from error
        half = solve_triangular(L, np.diag(scale), lower=True)
        return half.T @ half

    def estimate_noise(self) -> np.ndarray:
        """Estimate the three noises once, by their variance components; returns their relative changes (3,).

        The blur of each photo is estimated too, with a weight of its own for the noise of all.
        """
        system = self.system()
        share = ((system.J @ self.covariance(system)) * system.J).sum(1)
        values = self.noise.values()
        for group in range(3):
            rows = system.group == group
            redundancy = rows.sum() - share[rows].sum()
            if redundancy > 1.0:
                values[group] *= np.sqrt(float(system.r[rows] @ system.r[rows]) / redundancy)
        for number, photo in enumerate(self.photos):
            rows = system.photo == number
            square, redundancy = float(system.r[rows] @ system.r[rows]), float(rows.sum() - share[rows].sum())
            photo.blur = float(np.sqrt((photo.blur**2 * square + _ALIKE) / (max(redundancy, 0.0) + _ALIKE)))
        before, values = self.noise.values(), np.maximum(values, _LEAST)
        self.noise = Noise(*values)
        return np.abs(values / before - 1.0)


class _Undo:
    """Values of a bundle, to go back to."""

    def __init__(self, bundle: Bundle) -> None:
        self._bundle, self._lens, self._scale = bundle, bundle.lens, bundle.scale
        self._poses = [block.X for block in bundle.blocks]

    def __call__(self) -> None:
        self._bundle.lens, self._bundle.scale = self._lens, self._scale
        for block, X in zip(self._bundle.blocks, self._poses, strict=True):
            block.X = X


def _weighted(r: np.ndarray, J: np.ndarray, width: int, scale: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Rows with the robust weight of each `width` of them together; as they are without a scale."""
    if scale is None:
        return r, J
    weight = np.repeat(1.0 / np.sqrt(1.0 + (r.reshape(-1, width) ** 2).sum(1) / scale**2), width)
    return r * weight, J * weight[:, None]


def _solve(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    try:
        return cho_solve(cho_factor(normal, lower=True), right)
    except np.linalg.LinAlgError as error:
        raise SolverError("the photos leave part of the calibration open: take more, from other sides") from error
