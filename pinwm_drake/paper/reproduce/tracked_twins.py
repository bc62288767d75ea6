"""Cells of twins from tracked poses: those of ASID and of 2D Physics."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pinwm_drake.capture.pusher import upright_shape
from pinwm_drake.experiments.twins import read_pushes, run_provenance
from pinwm_drake.files import prepare_folder
from pinwm_drake.identification.pose_tracker import PoseTracker, PoseTrackerOptions
from pinwm_drake.paper.asid_twin import asid_twin
from pinwm_drake.paper.baselines.asid.cross_entropy import GENEROUS, CrossEntropyBudget
from pinwm_drake.paper.baselines.asid.options import AsidOptions
from pinwm_drake.paper.baselines.planar.body import make_planar_body
from pinwm_drake.paper.baselines.planar.identify import PlanarOptions, identify_planar
from pinwm_drake.paper.baselines.planar.twin import planar_twin
from pinwm_drake.paper.reproduce.cell import Say
from pinwm_drake.paper.reproduce.scenes import TaskScene, task_scene
from pinwm_drake.paper.reproduce.systems import ASID, ASID_GENEROUS
from pinwm_drake.paper.reproduce.twins import IdentifiedCell
from pinwm_drake.rendering.ply import read_ply
from pinwm_drake.report.surfels.fit_results import ALIGN_FILE, read_offset, read_registration
from pinwm_drake.twin.origin import seen_in
from pinwm_drake.twin.twin import SURFELS_FILE, Twin
from pinwm_drake.twin.write import write_twin


@dataclass(frozen=True)
class TrackedTwinCell(IdentifiedCell):
    """Cell of a twin whose poses a tracker gives, without physics, and whose parameters follow from these.

    The system is "asid", "asid-generous" or "2d-physics", of which ASID alone can look for one unknown.
    """

    times = 0.005, 0.02

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Tracks the object and identifies the twin; see `Cell.make`."""
        scene, out = task_scene(self.surfels.capture.task), prepare_folder(root / self.key)
        twin = (self._asid if self.system in (ASID, ASID_GENEROUS) else self._planar)(root, out, scene)
        theta = {name: estimate.value for name, estimate in twin.theta.items()}
        estimates = {name: {"value": value, "interval": None, "identifiable": False} for name, value in theta.items()}
        return {"theta": theta, "estimates": estimates}

    @property
    def _tracker(self) -> PoseTrackerOptions:
        options = PoseTrackerOptions(num_threads=1)
        return replace(options, size=40.0, steps=2) if self.surfels.capture.quick else options

    def _asid(self, root: Path, out: Path, scene: TaskScene) -> Twin:
        capture = self.surfels.capture
        budget = GENEROUS if self.system == ASID_GENEROUS and not capture.quick else CrossEntropyBudget()
        options = AsidOptions(budget, friction=scene.spans.friction, tracker=self._tracker, num_threads=1)
        if self.only:
            true = {name: value for name, value in scene.true_theta.items() if not name.startswith("inertia")}
            held = {name: value for name, value in (true | {"inertia": 1.0}).items() if name != self.only}
            options = replace(options, free=(self.only,), held=held)
        paths = root / capture.key, root / self.surfels.key
        return asid_twin(*paths, out, seed=capture.seed, episodes=[capture.episode], options=options).twin

    def _planar(self, root: Path, out: Path, scene: TaskScene) -> Twin:
        folder = root / self.surfels.key
        capture, pushes = read_pushes(root / self.surfels.capture.key, [self.surfels.capture.episode])
        surfels, offset = read_ply(folder / SURFELS_FILE), read_offset(folder / ALIGN_FILE)
        registration = read_registration(folder / ALIGN_FILE)
        seen = seen_in(capture, registration)
        poses = PoseTracker(seen, surfels, offset, self._tracker).track(pushes[0]).poses
        # As it rests, in the orientation that the body is made for: where tracking fails, the pusher may be above it.
        height = float(pushes[0].trajectory.p_WP[0, 2] - seen.object.X_WO.p[2])
        body = make_planar_body(seen.object.mesh_path, seen.object.X_WO.q, height, height)
        found = identify_planar(
            body,
            poses,
            pushes[0].trajectory,
            upright_shape(capture.pusher).radius,
            mass=capture.object.mass or 1.0,
            gravity=capture.gravity,
            options=PlanarOptions(seed=self.surfels.capture.seed, friction=scene.spans.friction),
        )
        twin = planar_twin(found.properties, body, capture, pushes, surfels, offset, X_OS=registration)
        twin = replace(twin, provenance={**twin.provenance, **run_provenance()})
        write_twin(out, twin)
        return twin
