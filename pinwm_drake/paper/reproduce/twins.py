# SPDX-License-Identifier: MIT
"""Cells of captures and of twins."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.capture.pusher import upright_shape
from pinwm_drake.capture.refine import refine_capture
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.capture.write import write_pose_table
from pinwm_drake.experiments.alignment import align
from pinwm_drake.experiments.twins import identify, read_pushes, run_provenance
from pinwm_drake.files import prepare_folder
from pinwm_drake.geometry.meshes import half_diagonal, load_mesh
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.poses.tracker import PoseTracker, PoseTrackerOptions
from pinwm_drake.identification.unknowns import NUISANCES
from pinwm_drake.paper.baselines.asid.cross_entropy import GENEROUS, CrossEntropyBudget
from pinwm_drake.paper.baselines.asid.identify import AsidOptions, identify_asid
from pinwm_drake.paper.baselines.planar.body import make_planar_body
from pinwm_drake.paper.baselines.planar.identify import PlanarOptions, identify_planar, planar_twin
from pinwm_drake.paper.reproduce.cell import DONE_FILE, Cell, Say, empty_folder
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import ASID, ASID_GENEROUS, PIN_WM, SceneCell, task_scene
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.ply import read_ply
from pinwm_drake.report.surfels.fit_results import ALIGN_FILE, read_offset, read_registration
from pinwm_drake.systems.runs.simulated_capture import simulate_capture
from pinwm_drake.twin.origin import seen_in
from pinwm_drake.twin.twin import SURFELS_FILE, Twin
from pinwm_drake.twin.write import write_twin

_STEEP = (0.8, 1.2)  # rad, of the way of the stand-in's poke over level
_QUICK_ITERATIONS, _QUICK_SURFELS, _QUICK_STEPS = 100, 300, 5


@dataclass(frozen=True)
class CaptureCell(SceneCell):
    """Cell of a capture that Drake simulates; in the stand-in for a robot, of its object and in its light.

    Attributes:
        quick: Flag: few and small images.
        forces: Flag: the force on the pusher is measured, and the mass is not.
    """

    path = "captures/{self.place}"
    times = 0.02, 0.05

    quick: bool = False
    forces: bool = False

    @property
    def place(self) -> str:
        """Path within the folders of what is made of it."""
        forces, stand_in = "-forces" * self.forces, "-stand-in" * self.stand_in
        return f"{self.task}{forces}{stand_in}/seed-{self.seed}"

    @property
    def episode(self) -> str:
        """Episode that is identified from."""
        return "0000" if self.stand_in else self.scene.episode

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Films the object at rest and twice in motion, once in the stand-in; see `Cell.make`.

        In the stand-in, a second poke that rocks the object would take long to find, and the one is steeper: one of 36
        degrees did not tell the friction of the pusher.
        """
        known = self.scene.capture(self.seed, quick=self.quick)
        options = replace(known, forces=self.forces, stand_in=self.stand_in)
        if self.stand_in:
            options = replace(options, episodes=1, rise=_STEEP)
        simulate_capture(options, empty_folder(root / self.key))
        return {"object": options.object_name, "friction": options.friction}


@dataclass(frozen=True)
class NoisyCaptureCell(Cell):
    """Cell of a capture whose mesh is known with an error only: its images are those of the true object.

    Attributes:
        share: Standard deviation of the vertices, along each axis, by the diagonal of the mesh's box.
        refined: Flag: the mesh is then fitted to the masks of the static views, as `pinwm capture refine` does.
    """

    path = "captures/{self.place}"
    times = 0.001, 0.001

    capture: CaptureCell
    share: float
    refined: bool = False

    @property
    def task(self) -> str:
        """Name of the task's scene."""
        return self.capture.task

    @property
    def seed(self) -> int:
        """Seed of the experiment."""
        return self.capture.seed

    @property
    def place(self) -> str:
        """Path within the folders of what is made of it."""
        return f"{self.task}-noise-{self.share:g}{'-refined' if self.refined else ''}/seed-{self.seed}"

    @property
    def episode(self) -> str:
        """Episode that is identified from."""
        return self.capture.episode

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Copy the capture, and move the vertices of its mesh; see `Cell.make`."""
        if self.refined:
            known = replace(self, refined=False)
            out = empty_folder(root / self.key)
            noisy = empty_folder(out.with_name(f".{out.name}"))
            told = known._copied(root, noisy)
            found = refine_capture(noisy, out)
            shutil.rmtree(noisy)
            return {**told, "masks": {"before": found.before, "after": found.after}}
        return self._copied(root, empty_folder(root / self.key))

    def _copied(self, root: Path, out: Path) -> Mapping[str, Any]:
        """Write the capture with the moved vertices to a folder, and tell how far they were moved."""
        ignored = shutil.ignore_patterns(DONE_FILE)
        shutil.copytree(root / self.capture.key, out, ignore=ignored, dirs_exist_ok=True)
        path = load_capture(out).object.mesh_path
        mesh = load_mesh(path)
        sigma = 2.0 * self.share * half_diagonal(mesh)
        mesh.vertices = mesh.vertices + np.random.default_rng(self.seed).normal(0.0, sigma, mesh.vertices.shape)
        mesh.export(path)
        return {"sigma": sigma, "vertices": len(mesh.vertices)}


Captured = CaptureCell | NoisyCaptureCell


@dataclass(frozen=True)
class SurfelsCell(Cell):
    """Cell of the surfels that are fitted to a capture's static views: the appearance of all twins of it."""

    path = "surfels/{self.capture.place}"
    times = 0.005, 0.03

    capture: Captured

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Fits the surfels; see `Cell.make`."""
        options = FitOptions(seed=self.capture.seed, num_threads=1)
        if self.capture.quick:
            options = replace(options, iterations=_QUICK_ITERATIONS, max_surfels=_QUICK_SURFELS, sh_degree=1)
        out = prepare_folder(root / self.key)
        result = align(root / self.capture.key, out, options=options, resume=True)
        return {"surfels": result.surfels.num_surfels, "psnr": list(result.psnr_test.values())}


@dataclass(frozen=True)
class IdentifiedCell(Cell):
    """Cell of a twin that a system identifies from one push; the systems are its subclasses.

    Attributes:
        only: Name of the one physical unknown that is looked for, while the others have their true values; "" for what
            is looked for by default.
    """

    surfels: SurfelsCell
    system: str
    only: str = ""

    @property
    def key(self) -> str:
        """Path of its folder."""
        return f"twins/{self.system}{'-' if self.only else ''}{self.only}/{self.surfels.capture.place}"

    def held(self) -> dict[str, float]:
        """Return True values of what is not looked for, where one unknown alone is; without inertia."""
        true = task_scene(self.surfels.capture.task).true_theta
        return {name: value for name, value in true.items() if name != self.only and not name.startswith("inertia")}

    def told(self, twin: Twin) -> dict[str, Any]:
        """Return the result of the cell: what is known of theta."""
        estimates = {
            name: {
                "value": one.value,
                "interval": one.interval and list(one.interval),
                "identifiable": one.identifiable and self.system == PIN_WM,
            }
            for name, one in twin.theta.items()
        }
        return {"theta": {name: one.value for name, one in twin.theta.items()}, "estimates": estimates}


@dataclass(frozen=True)
class TwinCell(IdentifiedCell):
    """Cell of a twin that PIN-WM identifies from the images of one push."""

    times = 0.01, 0.05

    system: str = PIN_WM

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Identify the twin; see `Cell.make`."""
        capture, out = self.surfels.capture, prepare_folder(root / self.key)
        for name in (SURFELS_FILE, ALIGN_FILE):
            shutil.copyfile(root / self.surfels.key / name, out / name)
        options = IdentifyOptions(seed=capture.seed, num_threads=1)
        if capture.quick:
            options = replace(options, starts=1, coarse_iterations=_QUICK_STEPS, fine_iterations=1, moves=5, screened=8)
        if self.only:
            options = replace(options, free=(self.only, *NUISANCES), held=self.held())
        found = identify(root / capture.key, out, episodes=[capture.episode], options=options, resume=True)
        return {**self.told(found.twin), "loss": found.found.loss, "seconds": found.found.seconds}


@dataclass(frozen=True)
class TrackedTwinCell(IdentifiedCell):
    """Cell of a twin whose poses a tracker gives, without physics, and whose parameters follow from these.

    The system is "asid", "asid-generous" or "2d-physics", of which ASID alone can look for one unknown.
    """

    times = 0.005, 0.02

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Tracks the object and identifies the twin; see `Cell.make`."""
        folder, out, cell = root / self.surfels.key, prepare_folder(root / self.key), self.surfels.capture
        capture, (push,) = read_pushes(root / cell.key, [cell.episode])
        surfels, offset = read_ply(folder / SURFELS_FILE), read_offset(folder / ALIGN_FILE)
        X_OS, friction = read_registration(folder / ALIGN_FILE), task_scene(cell.task).spans.friction
        tracker = PoseTrackerOptions(num_threads=1)
        if cell.quick:
            tracker = replace(tracker, size=40.0, steps=2)
        if self.system in (ASID, ASID_GENEROUS):
            budget = GENEROUS if self.system == ASID_GENEROUS and not cell.quick else CrossEntropyBudget()
            options = AsidOptions(budget, friction=friction, tracker=tracker, num_threads=1)
            if self.only:
                options = replace(options, free=(self.only,), held=self.held() | {"inertia": 1.0})
            found = identify_asid(capture, push, surfels, offset, options, seed=cell.seed, X_OS=X_OS)
            twin, poses = found.twin, found.poses[0]
        else:
            seen = seen_in(capture, X_OS)
            poses = PoseTracker(seen, surfels, offset, tracker).track(push).poses
            # As it rests, in the orientation that the body is made for: where tracking fails, the pusher may be above.
            height = float(push.trajectory.p_WP[0, 2] - seen.object.X_WO.p[2])
            body = make_planar_body(seen.object.mesh_path, seen.object.X_WO.q, height, height)
            properties = identify_planar(
                body,
                poses,
                push.trajectory,
                upright_shape(capture.pusher).radius,
                mass=capture.object.mass or 1.0,
                gravity=capture.gravity,
                options=PlanarOptions(seed=cell.seed, friction=friction),
            ).properties
            twin = planar_twin(properties, body, capture, [push], surfels, offset, X_OS=X_OS)
        write_pose_table(prepare_folder(out / "episodes") / f"{push.name}.csv", poses)
        twin = replace(twin, provenance={**twin.provenance, **run_provenance()})
        write_twin(out, twin)
        return self.told(twin)


def twin_cell(
    request: ReproduceRequest, task: str, seed: int, system: str = PIN_WM, only: str = "", *, stand_in: bool = False
) -> IdentifiedCell:
    """Cell of the twin that a system identifies, by one unknown alone where it is named; maybe in the stand-in."""
    surfels = SurfelsCell(CaptureCell(task, seed, quick=request.quick, stand_in=stand_in))
    return TwinCell(surfels, only=only) if system == PIN_WM else TrackedTwinCell(surfels, system, only)
