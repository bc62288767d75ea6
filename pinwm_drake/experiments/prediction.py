# SPDX-License-Identifier: MIT
"""The prediction of a twin for an episode."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pinwm_drake.capture.episodes import Episode, ObjectPoses, read_episode_folder, tell_doubts
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import Capture
from pinwm_drake.experiments.progress import Progress, silent
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.identification.locate import locate
from pinwm_drake.report.inline_page import InlinePage, inline_page
from pinwm_drake.report.twin.score import PoseErrors, pose_errors
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import turn_between
from pinwm_drake.twin.frame import in_world
from pinwm_drake.twin.origin import identified_push, start_pose
from pinwm_drake.twin.predict import Spread, mismatches, predict_motion
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.twin import Twin

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Prediction:
    """Motion of an object that a twin predicts for an episode.

    Attributes:
        twin: The twin.
        capture: Capture of the episode.
        episode: The episode.
        push: Number of the identified push that the episode is; None for another one.
        start: Pose of the object in the first frame, where it was looked for.
        poses: Poses of the object at the times of the frames, world.
        spread: Standard deviations of the poses; None for a twin without draws.
        warnings: Differences of the capture's scene from that of the twin, in words.
    """

    twin: Twin
    capture: Capture
    episode: Episode
    push: int | None
    start: Pose | None
    poses: ObjectPoses
    spread: Spread | None
    warnings: list[str]

    @property
    def motion(self) -> tuple[float, float]:
        """Translation [m] and rotation [rad] of the object from the first frame to the last."""
        share = min(float(np.abs(self.poses.q_WO[-1] @ self.poses.q_WO[0])), 1.0)
        return float(np.linalg.norm(self.poses.p_WO[-1] - self.poses.p_WO[0])), float(2 * np.arccos(share))

    @property
    def start_shift(self) -> tuple[float, float]:
        """Way [m] and turn [rad] about z from the written start to the one that was found; 0 where none was."""
        written = self.capture.object.X_WO if self.episode.start is None else self.episode.start
        if self.start is None:
            return 0.0, 0.0
        turn = float(turn_between(written.q, self.start.q)[2])
        return float((self.start.p - written.p)[:2].norm()), turn

    @property
    def errors(self) -> PoseErrors | None:
        """Errors against the episode's recorded poses; None where it has none."""
        truth = self.episode.object_poses
        return None if truth is None else pose_errors(self.poses, truth)

    def filmstrip(self, frames: int = 4, size: int = 150) -> np.ndarray:
        """Picture of some frames side by side: what the camera saw, what the twin shows, and the difference below.

        Args:
            frames: Number of frames at most, evenly spaced.
            size: Longer side of a frame at most, px.

        Returns:
            (height, width, 3) uint8, sRGB.

        Raises:
            InputError: An image of the episode cannot be read.
        """
        from pinwm_drake.report.twin.comparison_frames import Cast, draw_shots

        shots = draw_shots(self.episode, self.poses, Cast.of(self.twin, self.push), size=size, most=frames)
        return np.concatenate([np.concatenate(shot.panels) for shot in shots], axis=1)

    def figure(self) -> "Figure":
        """Figure of the object's motion over time: predicted, with its 95 % band, and as it was recorded."""
        from pinwm_drake.report.figures.poses import motion_figure

        pusher = in_world(self.twin, self.episode.trajectory)
        return motion_figure(self.poses, self.episode.object_poses, pusher, self.spread)

    def meshcat(self, height: int = 420) -> InlinePage:
        """Meshcat's page of the motion, for a notebook: predicted in red, recorded in grey, and the pusher in blue.

        Args:
            height: px, of the frame in the notebook.

        Raises:
            ParameterError: No port of this machine is free.
        """
        from matplotlib.colors import to_rgb

        from pinwm_drake.report.style import PUSHER, TRUTH, TWIN
        from pinwm_drake.systems.view.motion import Moving, motion_page

        mesh, poses, truth = load_mesh(self.twin.mesh_path), self.poses, self.episode.object_poses
        bodies = {"twin": Moving(mesh, poses.t, poses.p_WO, poses.q_WO, to_rgb(TWIN))}
        if truth is not None:
            bodies["recorded"] = Moving(mesh, truth.t, truth.p_WO, truth.q_WO, to_rgb(TRUTH), 0.35)
        pusher = in_world(self.twin, self.episode.trajectory)
        bodies["pusher"] = Moving(pusher_surface(self.twin.pusher), pusher.t, pusher.p_WP, pusher.q_WP, to_rgb(PUSHER))
        return inline_page(motion_page(bodies, self.twin.floor_height), height)


def predict(
    twin: Twin | Path | str, episode: Path | str, *, find_start: bool = False, progress: Progress = silent
) -> Prediction:
    """Predict the motion of an object in an episode from the pusher's log.

    Args:
        twin: A twin, the folder of one, or the name of one that ships.
        episode: Folder of the episode, CAPTURE/episodes/NAME.
        find_start: Flag: the object is looked for in the first picture; otherwise it is where capture.yaml says.
        progress: Called with the stage "predicting".

    Raises:
        PinwmError: A file cannot be used, or the physics found no solution.
    """
    found = twin if isinstance(twin, Twin) else load_twin(twin)
    capture, push = read_episode_folder(Path(episode))
    tell_doubts(push)
    number = identified_push(found, capture, push)
    progress("predicting", 0.0, "start of the object" if find_start else "motion")
    start = None
    if find_start:
        start = locate(found, push, start_pose(found, capture, number, push))
        progress("predicting", 0.3, "motion")
    poses, spread = predict_motion(found, capture, push, number, start=start)
    return Prediction(found, capture, push, number, start, poses, spread, mismatches(found, capture))
