"""Captures as a lab has them: the poses of an engine, seen by one lamp, with the mistakes of `realism.mistakes`."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.next_push.captures import (
    FIELD_OF_VIEW,
    Size,
    episode_viewpoint,
    object_poses,
    pusher_log,
    static_viewpoints,
    write_scene,
)
from benchmarks.next_push.engines.drake import make_recorder
from benchmarks.next_push.objects import Thing
from benchmarks.next_push.poses import PER_FRAME, PosedCapture
from benchmarks.next_push.specification import CaptureSpec
from pinwm_drake.capture.write import write_episode_tables, write_transforms
from pinwm_drake.files import appearing
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.systems.runs.realism.camera import LabCamera
from pinwm_drake.systems.runs.realism.lamp import glossy_model
from pinwm_drake.systems.runs.realism.mistakes import MARGIN, Realism, late_log, moved_camera, moved_on_floor
from pinwm_drake.systems.runs.simulated_capture import to_pose

_SUPERSAMPLING = 2


def write_realistic_capture(
    out: Path,
    spec: CaptureSpec,
    thing: Thing,
    posed: PosedCapture,
    size: Size | None = None,
    realism: Realism | None = None,
) -> dict[str, Any]:
    """Writes a realistic capture.

    Args:
        out: Its folder, not there yet; it appears when all is done.
        spec: The capture.
        thing: Its object.
        posed: Its poses, of an uneven object.
        size: Of its pictures; 400 px and 12 views by default.
        realism: How large its mistakes are.

    Returns:
        The mistakes that were made: start pose, clocks, cameras; SI units.
    """
    size, realism = size or Size(), realism or Realism()
    camera = Camera.from_field_of_view(size.pixels, size.pixels, FIELD_OF_VIEW)
    with appearing(out) as folder, tempfile.TemporaryDirectory() as models:
        seen = glossy_model(thing.visual_path, Path(models))
        recorder = make_recorder("hydroelastic", thing, posed.theta, spec.shape, camera, _SUPERSAMPLING, seen=seen)
        generator = np.random.default_rng([spec.seed, 5])
        lab = LabCamera(recorder, realism, thing.mesh().convex_hull.vertices, generator)
        return _Writer(folder, spec, thing, posed, lab, generator).write(size)


class _Writer:
    """A realistic capture in the making."""

    def __init__(
        self,
        folder: Path,
        spec: CaptureSpec,
        thing: Thing,
        posed: PosedCapture,
        lab: LabCamera,
        generator: np.random.Generator,
    ) -> None:
        self.folder, self.spec, self.thing, self.posed = folder, spec, thing, posed
        self.lab, self.realism, self.generator = lab, lab.realism, generator

    def write(self, size: Size) -> dict[str, Any]:
        """Writes all files."""
        realism, X_WO = self.realism, self.posed.X_WO
        start = moved_on_floor(X_WO, realism.start_place, realism.start_turn, self.generator)
        write_scene(self.folder, self.spec, self.thing, self.posed, start)
        self._write_static_views(size.views)
        episodes = [self._write_episode(k) for k in range(len(self.posed.pushes))]
        turn = (X_WO.rotation().inverse() @ start.rotation()).ToAngleAxis().angle()
        return {
            "start_shift": (start.translation() - X_WO.translation()).tolist(),
            "start_turn": float(turn),
            "wider": self.lab.wider,
            "episodes": episodes,
        }

    def _write_static_views(self, count: int) -> None:
        views = static_viewpoints(self.spec, self.thing, self.posed, count)
        folder = self.folder / "static"
        (folder / "images").mkdir(parents=True)
        frames = []
        for k, (X_WC, picture) in enumerate(zip(views, self.lab.still(self.posed.X_WO, views), strict=True)):
            name = f"images/{k:05d}.png"
            Image.fromarray(picture).save(folder / name)
            moved = moved_camera(X_WC, self.realism.static_place, self.realism.static_turn, self.generator)
            frames.append((name, to_pose(moved)))
        write_transforms(folder / "transforms.json", self.lab.recorder.rig.camera, frames)

    def _write_episode(self, number: int) -> dict[str, Any]:
        X_WC = episode_viewpoint(self.spec, self.thing, self.posed, number)
        rollout, folder = self.posed.rollouts[number], self.folder / "episodes" / f"{number:04d}"
        (folder / "rgb").mkdir(parents=True)
        t = rollout.t[::PER_FRAME]
        names = [f"rgb/{k:05d}.png" for k in range(len(t))]
        film = self.lab.film(rollout.t, rollout.X_WO, rollout.p_WP, t, X_WC)
        for name, picture in zip(names, film, strict=True):
            Image.fromarray(picture).save(folder / name)
        moved = moved_camera(X_WC, self.realism.episode_place, self.realism.episode_turn, self.generator)
        late = float(self.generator.uniform(-self.realism.clock, self.realism.clock))
        log = late_log(pusher_log(self.posed, number), late, MARGIN)
        camera = self.lab.recorder.rig.camera
        write_episode_tables(folder, camera, to_pose(moved), names, t, log, object_poses(self.posed, number))
        return {"log_late": late, "camera_shift": (moved.translation() - X_WC.translation()).tolist()}
