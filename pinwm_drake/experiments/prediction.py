# SPDX-License-Identifier: MIT
"""The prediction of a twin for an episode."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinwm_drake.capture.episodes import Episode, ObjectPoses, read_episode_folder
from pinwm_drake.capture.scene import Capture
from pinwm_drake.experiments.progress import Progress, silent
from pinwm_drake.identification.locate import locate
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import turn_between
from pinwm_drake.twin.origin import identified_push, start_pose
from pinwm_drake.twin.predict import Spread, mismatches, predict_poses, predict_spread
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.twin import Twin


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
        written = self.capture.object.X_WO
        if self.start is None:
            return 0.0, 0.0
        turn = float(turn_between(written.q, self.start.q)[2])
        return float((self.start.p - written.p)[:2].norm()), turn


def predict(
    twin: Path | str, episode: Path | str, *, find_start: bool = False, progress: Progress = silent
) -> Prediction:
    """Predicts the motion of an object in an episode from the pusher's log.

    Args:
        twin: Folder of the twin, or the name of one that ships.
        episode: Folder of the episode, CAPTURE/episodes/NAME.
        find_start: Flag: the object is looked for in the first picture; otherwise it is where capture.yaml says.
        progress: Called with the stage "predicting".

    Raises:
        PinwmError: A file cannot be used, or the physics found no solution.
    """
    found = load_twin(twin)
    capture, push = read_episode_folder(Path(episode))
    number = identified_push(found, capture, push)
    progress("predicting", 0.0, "start of the object" if find_start else "motion")
    start = locate(found, push, start_pose(found, capture, number)) if find_start else None
    progress("predicting", 0.3, "motion")
    poses = predict_poses(found, capture, push, number, start=start)
    progress("predicting", 0.6, "95 % band")
    spread = predict_spread(found, capture, push, number, start=start)
    return Prediction(found, capture, push, number, start, poses, spread, mismatches(found, capture))
