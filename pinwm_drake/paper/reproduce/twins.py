"""Cells of captures and twins."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.capture.refine import refine_capture
from pinwm_drake.capture.scene import read_capture
from pinwm_drake.experiments.alignment import align
from pinwm_drake.experiments.twins import twin_from_capture
from pinwm_drake.files import prepare_folder
from pinwm_drake.geometry.meshes import half_diagonal, load_mesh
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.unknowns import NUISANCES
from pinwm_drake.paper.reproduce.cell import DONE_FILE, Cell, Say, empty_folder
from pinwm_drake.paper.reproduce.scenes import scene_folder, task_scene
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.report.surfels.fit_results import ALIGN_FILE
from pinwm_drake.systems.runs.simulated_capture import simulate_capture
from pinwm_drake.twin.twin import SURFELS_FILE

_STEEP = (0.8, 1.2)  # rad, of the way of the stand-in's poke over level
_QUICK_ITERATIONS, _QUICK_SURFELS, _QUICK_STEPS = 100, 300, 5


@dataclass(frozen=True)
class CaptureCell(Cell):
    """Cell of a capture that Drake simulates.

    Attributes:
        task: Name of the task's scene.
        seed: Seed of the experiment.
        quick: Flag: few and small images.
        forces: Flag: the force on the pusher is measured, and the mass is not.
        stand_in: Flag: of the object and in the light of the stand-in for a robot, as a lab has it; see `StandIn`.
    """

    path = "captures/{self.place}"
    times = 0.02, 0.05

    task: str
    seed: int
    quick: bool = False
    forces: bool = False
    stand_in: bool = False

    @property
    def place(self) -> str:
        """Path within the folders of what is made of it."""
        scene = scene_folder(f"{self.task}-forces" if self.forces else self.task, self.stand_in)
        return f"{scene}/seed-{self.seed}"

    @property
    def episode(self) -> str:
        """Episode that is identified from."""
        return "0000" if self.stand_in else task_scene(self.task).episode

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Films the object at rest and twice in motion, once in the stand-in; see `Cell.make`.

        In the stand-in, a second poke that rocks the object would take long to find, and the one is steeper: one of 36
        degrees did not tell the friction of the pusher.
        """
        known = task_scene(self.task).capture(self.seed, quick=self.quick)
        options = replace(known, forces=self.forces, stand_in=self.stand_in)
        if self.stand_in:
            options = replace(options, episodes=1, rise=_STEEP)
        simulate_capture(options, empty_folder(root / self.key))
        return {"object": options.object_name, "friction": options.friction}


@dataclass(frozen=True)
class NoisyCaptureCell(Cell):
    """Cell of a capture whose mesh is known with an error only: its images are those of the true object.

    Attributes:
        capture: Cell of the capture.
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
    def quick(self) -> bool:
        """Flag: few and small images."""
        return self.capture.quick

    @property
    def place(self) -> str:
        """Path within the folders of what is made of it."""
        return f"{self.task}-noise-{self.share:g}{'-refined' if self.refined else ''}/seed-{self.seed}"

    @property
    def episode(self) -> str:
        """Episode that is identified from."""
        return self.capture.episode

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Copies the capture, and moves the vertices of its mesh; see `Cell.make`."""
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
        """Writes the capture with the moved vertices to a folder, and tells how far they were moved."""
        ignored = shutil.ignore_patterns(DONE_FILE)
        shutil.copytree(root / self.capture.key, out, ignore=ignored, dirs_exist_ok=True)
        path = read_capture(out).object.mesh_path
        mesh = load_mesh(path)
        sigma = 2.0 * self.share * half_diagonal(mesh)
        mesh.vertices = mesh.vertices + np.random.default_rng(self.seed).normal(0.0, sigma, mesh.vertices.shape)
        mesh.export(path)
        return {"sigma": sigma, "vertices": len(mesh.vertices)}


Captured = CaptureCell | NoisyCaptureCell


@dataclass(frozen=True)
class SurfelsCell(Cell):
    """Cell of the surfels that are fitted to a capture's static views: the appearance of all twins of it.

    Attributes:
        capture: Cell of the capture.
    """

    path = "surfels/{self.capture.place}"
    times = 0.005, 0.03

    capture: Captured

    @property
    def quick(self) -> bool:
        """Flag: its capture is a quick one."""
        return self.capture.quick

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
        surfels: Cell of the appearance.
        system: Name of the identification.
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

    @property
    def needs(self) -> tuple[Cell, ...]:
        """Surfels, and their capture."""
        return (self.surfels, self.surfels.capture)

    @property
    def quick(self) -> bool:
        """Flag: its capture is a quick one."""
        return self.surfels.capture.quick


@dataclass(frozen=True)
class TwinCell(IdentifiedCell):
    """Cell of a twin that PIN-WM identifies from the images of one push."""

    times = 0.01, 0.05

    system: str = "pin-wm"

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Identifies the twin; see `Cell.make`."""
        capture, out = self.surfels.capture, prepare_folder(root / self.key)
        for name in (SURFELS_FILE, ALIGN_FILE):
            shutil.copyfile(root / self.surfels.key / name, out / name)
        options = IdentifyOptions(seed=capture.seed, num_threads=1)
        if capture.quick:
            options = replace(options, starts=1, coarse_iterations=_QUICK_STEPS, fine_iterations=1, moves=5, screened=8)
        scene = task_scene(capture.task)
        if self.only:
            true = {name: value for name, value in scene.true_theta.items() if not name.startswith("inertia")}
            held = {name: value for name, value in true.items() if name != self.only}
            options = replace(options, free=(self.only, *NUISANCES), held=held)
        found = twin_from_capture(root / capture.key, out, episodes=[capture.episode], options=options, resume=True)
        theta = {name: estimate.value for name, estimate in found.twin.theta.items()}
        estimates = {
            name: {
                "value": one.value,
                "interval": one.interval and list(one.interval),
                "identifiable": one.identifiable,
            }
            for name, one in found.twin.theta.items()
        }
        return {"theta": theta, "estimates": estimates, "loss": found.found.loss, "seconds": found.found.seconds}
