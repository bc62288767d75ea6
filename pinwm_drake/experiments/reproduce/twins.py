"""Cells of captures and twins."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pinwm_drake.experiments.alignment import align
from pinwm_drake.experiments.reproduce.cell import Cell, Say, empty_folder
from pinwm_drake.experiments.reproduce.scenes import task_scene
from pinwm_drake.experiments.twins import twin_from_capture
from pinwm_drake.files import prepare_folder
from pinwm_drake.identification import IdentifyOptions
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.report.surfels.fit_results import ALIGN_FILE
from pinwm_drake.systems.runs.simulated_capture import simulate_capture
from pinwm_drake.twin import SURFELS_FILE

_QUICK_ITERATIONS, _QUICK_SURFELS, _QUICK_STEPS = 100, 300, 5


@dataclass(frozen=True)
class CaptureCell:
    """Cell of a capture that Drake simulates.

    Attributes:
        task: Name of the task.
        seed: Seed of the experiment.
        quick: Flag: few and small images.
    """

    task: str
    seed: int
    quick: bool = False

    @property
    def key(self) -> str:
        """Path of its folder."""
        return f"captures/{self.task}/seed-{self.seed}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        """None: it begins with nothing."""
        return ()

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return 0.02 if self.quick else 0.05

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Films the object at rest and twice in motion; see `Cell.make`."""
        options = task_scene(self.task).capture(self.seed, quick=self.quick)
        simulate_capture(options, empty_folder(root / self.key))
        return {"object": options.object_name, "friction": options.friction}


@dataclass(frozen=True)
class SurfelsCell:
    """Cell of the surfels that are fitted to a capture's static views: the appearance of all twins of it.

    Attributes:
        capture: Cell of the capture.
    """

    capture: CaptureCell

    @property
    def key(self) -> str:
        """Path of its folder."""
        return f"surfels/{self.capture.task}/seed-{self.capture.seed}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        """Cell of the capture."""
        return (self.capture,)

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return 0.005 if self.capture.quick else 0.03

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Fits the surfels; see `Cell.make`."""
        options = FitOptions(seed=self.capture.seed, num_threads=1)
        if self.capture.quick:
            options = replace(options, iterations=_QUICK_ITERATIONS, max_surfels=_QUICK_SURFELS, sh_degree=1)
        out = prepare_folder(root / self.key)
        result = align(root / self.capture.key, out, options=options, resume=True)
        return {"surfels": result.surfels.num_surfels, "psnr": list(result.psnr_test.values())}


@dataclass(frozen=True)
class TwinCell:
    """Cell of a twin that PIN-WM identifies from one push.

    Attributes:
        surfels: Cell of the appearance.
        system: Name of the identification.
    """

    surfels: SurfelsCell
    system: str = "pin-wm"

    @property
    def key(self) -> str:
        """Path of its folder."""
        return f"twins/{self.surfels.capture.task}/{self.system}/seed-{self.surfels.capture.seed}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        """Surfels, and their capture."""
        return (self.surfels, self.surfels.capture)

    @property
    def hours(self) -> float:
        """Estimate of its time, h."""
        return 0.01 if self.surfels.capture.quick else 0.05

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Identifies the twin; see `Cell.make`."""
        capture, out = self.surfels.capture, prepare_folder(root / self.key)
        for name in (SURFELS_FILE, ALIGN_FILE):
            shutil.copyfile(root / self.surfels.key / name, out / name)
        options = IdentifyOptions(seed=capture.seed, num_threads=1)
        if capture.quick:
            options = replace(options, starts=1, coarse_iterations=_QUICK_STEPS, fine_iterations=1, moves=5, screened=8)
        episode = task_scene(capture.task).episode
        found = twin_from_capture(root / capture.key, out, episodes=[episode], options=options, resume=True)
        theta = {name: estimate.value for name, estimate in found.twin.theta.items()}
        return {"theta": theta, "loss": found.found.loss, "seconds": found.found.seconds}
