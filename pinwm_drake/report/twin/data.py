# SPDX-License-Identifier: MIT
"""Contents of a twin's report, read from the twin's folder and from its capture."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from pinwm_drake.capture.episode_tables import read_pose_table
from pinwm_drake.capture.episodes import Episode, ObjectPoses, read_episode
from pinwm_drake.capture.ground_truth import GROUND_TRUTH_FILE
from pinwm_drake.capture.scene import Capture, load_capture
from pinwm_drake.documents import read_yaml
from pinwm_drake.errors import InputError, PinwmError
from pinwm_drake.identification.history import HISTORY_FILE, History, read_history
from pinwm_drake.twin.origin import Origin, hash_capture
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.twin import THETA, Twin

# Parameters for which a simulator may have one value.
_COMMON = {"restitution_floor": "restitution", "restitution_pusher": "restitution"}
_SAME_TIME = 1e-6  # s
_Result = TypeVar("_Result")


@dataclass
class Story:
    """Twin, and the records of its identification that are at hand; None where one is not."""

    twin: Twin
    origin: Origin | None  # None where its provenance does not say
    history: History | None = None
    poses: ObjectPoses | None = None  # identified, at the frames
    capture: Capture | None = None
    episode: Episode | None = None  # the identified one
    truth: dict[str, float] = field(default_factory=dict)  # of physical parameters, where the capture knows them
    notices: list[str] = field(default_factory=list)  # missing parts and contradictions, in words

    def attempt(self, work: Callable[[], _Result], consequence: str) -> _Result | None:
        """Return the result of `work`; None and a notice where an input is refused."""
        try:
            return work()
        except PinwmError as error:
            self.notices.append(f"{error}. {consequence}")
            return None


def read_story(folder: Path, capture: Path | None = None) -> Story:
    """Read a twin folder and, where it is still there, the capture.

    Parts that cannot be read but are not needed stand in the notices.

    Args:
        folder: The twin.
        capture: Present folder of the capture; None for that at the time of the identification.

    Raises:
        InputError: The twin cannot be read, or the capture that `capture` names.
    """
    twin = load_twin(folder)
    story = Story(twin, Origin.read(twin))
    path = folder / HISTORY_FILE
    story.history = story.attempt(lambda: read_history(path), "The course of the identification is left out.")
    story.poses = story.attempt(lambda: _read_poses(folder, story.origin), "The identified motion is left out.")
    frame = story.twin.provenance.get("frame")
    if isinstance(frame, dict) and "note" in frame:
        story.notices.append(str(frame["note"]))
    where = capture or (story.origin.path if story.origin is not None else None)
    if where is None:
        story.notices.append("The twin does not say which capture it is from; --capture names it.")
        return story
    if capture is not None:
        story.capture = load_capture(capture)
    else:
        story.capture = story.attempt(
            lambda: load_capture(where), "So there are no pictures here; --capture names the place where it is now."
        )
    if story.capture is not None:
        _read_episode(story, story.capture)
    return story


def _read_poses(folder: Path, origin: Origin | None) -> ObjectPoses:
    """Return the identified poses: those of the episode that the provenance names, else the only ones there are."""
    found = sorted((folder / "episodes").glob("*.csv"))
    if origin is not None:
        found = [path for path in found if path.stem == origin.episodes[0]]
    if len(found) != 1:
        name = "one table" if origin is None else f"{origin.episodes[0]}.csv"
        raise InputError(folder / "episodes", value=f"{len(found)} such tables", allowed=f"{name} of identified poses")
    return read_pose_table(found[0])


def _read_episode(story: Story, capture: Capture) -> None:
    origin = story.origin
    name = origin.episodes[0] if origin is not None else next(iter(capture.episode_names), "")
    story.episode = story.attempt(lambda: read_episode(capture, name), "So there are no pictures here.")
    path = capture.folder / GROUND_TRUTH_FILE
    if path.is_file():
        story.truth = story.attempt(lambda: read_ground_truth(path), "True parameters are left out.") or {}
    if story.episode is None:
        return
    if origin is not None and hash_capture(capture.folder, origin.episodes) != origin.sha256:
        differs = f"{capture.folder} is not, or no longer, what the twin was identified from: its SHA-256 differs."
        story.notices.append(differs)
    poses, t = story.poses, story.episode.t
    if poses is not None and (len(poses.t) != len(t) or np.abs(poses.t - t).max() > _SAME_TIME):
        times = f"The {len(poses.t)} identified poses are not at the times of the {len(t)} frames of"
        story.notices.append(f"{times} {story.episode.folder}. So there are no pictures here.")
        story.episode = None


def read_ground_truth(path: Path) -> dict[str, float]:
    """Return True values of physical parameters from a YAML file, by their names in a twin; other keys do not count.

    Key `restitution` stands for all contacts. Raises InputError where a value is no finite number.
    """
    document = read_yaml(path)
    found = {key: document.find(key) or document.find(_COMMON.get(key, key)) for key in THETA}
    return {key: entry.number() for key, entry in found.items() if entry is not None and entry.value is not None}
