"""Captures as a lab has them: the poses of an engine, seen by one lamp, with the mistakes of `realism`."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from pydrake.math import RigidTransform
from scipy.spatial.transform import Rotation, Slerp

from benchmarks.next_push.captures import (
    FIELD_OF_VIEW,
    Size,
    episode_viewpoint,
    object_poses,
    pose,
    pusher_log,
    static_viewpoints,
    write_scene,
)
from benchmarks.next_push.engines.drake import make_recorder
from benchmarks.next_push.engines.rollout import Rollout
from benchmarks.next_push.lamp import glossy_model, light_by_lamp
from benchmarks.next_push.objects import Thing
from benchmarks.next_push.pictures import blurred, ragged
from benchmarks.next_push.poses import PER_FRAME, PosedCapture, quaternions, rigid
from benchmarks.next_push.realism import Realism, late_log, moved_camera, moved_on_floor
from benchmarks.next_push.specification import CaptureSpec
from pinwm_drake.capture.write import write_episode_tables, write_transforms
from pinwm_drake.files import appearing
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.systems.runs.recorder import PushRecorder

_SUPERSAMPLING = 2
_MOMENTS = 5  # of an exposure
_STILL = 2e-4  # m, that no corner moves by while an exposure needs no more than one moment
_MARGIN = 0.05  # s, by which a log is longer than the video at both ends


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
        return _Writer(folder, spec, thing, posed, recorder, realism).write(size)


class _Writer:
    """A realistic capture in the making."""

    def __init__(
        self,
        folder: Path,
        spec: CaptureSpec,
        thing: Thing,
        posed: PosedCapture,
        recorder: PushRecorder,
        realism: Realism,
    ) -> None:
        self.folder, self.spec, self.thing, self.posed = folder, spec, thing, posed
        self.recorder, self.realism = recorder, realism
        self.generator = np.random.default_rng([spec.seed, 5])
        self.corners = thing.mesh().convex_hull.vertices
        light_by_lamp(recorder, self.generator)
        tone = self.generator.uniform(90, 200) + self.generator.uniform(-25, 25, 3)
        self.behind = np.clip(tone, 0, 255).astype(np.uint8)
        self.wider = self.generator.uniform(-1, 1) * (realism.mask - realism.flicker)

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
            "wider": self.wider,
            "episodes": episodes,
        }

    def _write_static_views(self, count: int) -> None:
        views = static_viewpoints(self.spec, self.thing, self.posed, count)
        folder = self.folder / "static"
        (folder / "images").mkdir(parents=True)
        frames = []
        pictures = self.recorder.pictures([self.posed.X_WO] * count, views)
        for k, (X_WC, picture) in enumerate(zip(views, pictures, strict=True)):
            name = f"images/{k:05d}.png"
            Image.fromarray(self._masked(picture)).save(folder / name)
            moved = moved_camera(X_WC, self.realism.static_place, self.realism.static_turn, self.generator)
            frames.append((name, pose(moved)))
        write_transforms(folder / "transforms.json", self.recorder.rig.camera, frames)

    def _write_episode(self, number: int) -> dict[str, Any]:
        X_WC = episode_viewpoint(self.spec, self.thing, self.posed, number)
        rollout, folder = self.posed.rollouts[number], self.folder / "episodes" / f"{number:04d}"
        (folder / "rgb").mkdir(parents=True)
        t = rollout.t[::PER_FRAME]
        names = [f"rgb/{k:05d}.png" for k in range(len(t))]
        for name, picture in zip(names, self._exposures(rollout, t, X_WC), strict=True):
            Image.fromarray(self._masked(picture)).save(folder / name)
        moved = moved_camera(X_WC, self.realism.episode_place, self.realism.episode_turn, self.generator)
        late = float(self.generator.uniform(-self.realism.clock, self.realism.clock))
        log = late_log(pusher_log(self.posed, number), late, _MARGIN)
        camera = self.recorder.rig.camera
        write_episode_tables(folder, camera, pose(moved), names, t, log, object_poses(self.posed, number))
        return {"log_late": late, "camera_shift": (moved.translation() - X_WC.translation()).tolist()}

    def _exposures(self, rollout: Rollout, t: np.ndarray, X_WC: RigidTransform) -> Iterator[np.ndarray]:
        """Pictures of an episode, each blurred by the motion of its exposure."""
        spread = self.realism.exposure * (np.arange(_MOMENTS) + 0.5 - 0.5 * _MOMENTS) / _MOMENTS
        for time in t:
            X_WO, p_WP = moments(rollout, np.clip(time + spread, rollout.t[0], rollout.t[-1]))
            ends = [X.rotation().matrix() @ self.corners.T + X.translation()[:, None] for X in (X_WO[0], X_WO[-1])]
            if np.abs(ends[1] - ends[0]).max() < _STILL and np.abs(p_WP[-1] - p_WP[0]).max() < _STILL:
                X_WO, p_WP = X_WO[2:3], p_WP[2:3]
            yield blurred(self.recorder.pictures(X_WO, [X_WC] * len(X_WO), p_WP), self.behind)

    def _masked(self, picture: np.ndarray) -> np.ndarray:
        realism = self.realism
        wider = self.wider + self.generator.normal(0.0, realism.flicker)
        return ragged(picture, wider, self.behind, self.generator, most=realism.mask)


def moments(rollout: Rollout, t: np.ndarray) -> tuple[list[RigidTransform], np.ndarray]:
    """Poses of the object and places (n, 3) m of the pusher at times t (n,) s within a rollout."""
    q = quaternions(rollout.X_WO)
    p = np.array([X.translation() for X in rollout.X_WO])
    x, y, z, w = Slerp(rollout.t, Rotation.from_quat(q[:, [1, 2, 3, 0]]))(t).as_quat().T
    places = np.column_stack([np.interp(t, rollout.t, p[:, k]) for k in range(3)])
    p_WP = np.column_stack([np.interp(t, rollout.t, rollout.p_WP[:, k]) for k in range(3)])
    turned = np.column_stack([w, x, y, z])
    return [rigid(*each) for each in zip(turned, places, strict=True)], p_WP
