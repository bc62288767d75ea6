"""Origin of a twin: the episode that it was identified from, and the start of that episode."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from pinwm_drake.capture.episode_tables import POSES_FILE
from pinwm_drake.capture.episodes import Episode
from pinwm_drake.capture.ground_truth import GROUND_TRUTH_FILE
from pinwm_drake.capture.scene import Capture
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_multiply
from pinwm_drake.twin.twin import Twin

# The truth, where a capture has it, is no part of what a twin is made from.
_LEFT_OUT = (POSES_FILE, GROUND_TRUTH_FILE)


@dataclass(frozen=True)
class Origin:
    """Capture and episode that a twin was identified from.

    Attributes:
        path: Folder of the capture at that time.
        sha256: Hash of the capture, as `hash_capture` gives it.
        episode: The name of the episode.
    """

    path: Path
    sha256: str
    episode: str

    @staticmethod
    def of(capture: Capture, episode: Episode) -> "Origin":
        """The origin of a twin that is identified now; raises InputError where a file cannot be read."""
        return Origin(capture.folder.resolve(), hash_capture(capture.folder, episode.name), episode.name)

    @staticmethod
    def read(twin: Twin) -> "Origin | None":
        """Origin from the provenance of a twin; None where that does not say all of it."""
        found = [twin.provenance.get(key) for key in ("capture", "capture_sha256", "episode")]
        if not all(isinstance(value, str) and value for value in found):
            return None
        path, sha256, episode = map(str, found)
        return Origin(Path(path), sha256, episode)

    def to_provenance(self) -> dict[str, Any]:
        """The entries of a twin's provenance that `read` looks for."""
        return {"capture": str(self.path), "capture_sha256": self.sha256, "episode": self.episode}


def hash_capture(folder: Path, episode: str) -> str:
    """SHA-256 of all files of a capture that a twin is made from: names and contents, in the order of the names.

    Ground truth and other episodes do not count.

    Args:
        folder: The capture.
        episode: The name of the episode.

    Returns:
        64 hexadecimal digits.

    Raises:
        InputError: A file cannot be read.
    """
    digest = hashlib.sha256()
    for path in sorted(_files(folder, episode)):
        try:
            contents = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            raise InputError(path, value=error.strerror, allowed="a file that can be read") from error
        digest.update(f"{path.relative_to(folder).as_posix()}\n{contents}\n".encode("utf-8", "surrogateescape"))
    return digest.hexdigest()


def _files(folder: Path, episode: str) -> Iterator[Path]:
    yield folder / "capture.yaml"
    for part in ("meshes", "static", f"episodes/{episode}"):
        for path in (folder / part).rglob("*"):
            hidden = any(name.startswith(".") for name in path.relative_to(folder).parts)
            if path.is_file() and not hidden and path.name not in _LEFT_OUT:
                yield path


def is_identified_episode(twin: Twin, capture: Capture, episode: Episode) -> bool:
    """Flag: a twin was identified from this very episode, same name and same files, all of which are read.

    Raises:
        InputError: A file of the capture cannot be read.
    """
    origin = Origin.read(twin)
    return (
        origin is not None
        and origin.episode == episode.name
        and origin.sha256 == hash_capture(capture.folder, episode.name)
    )


def start_pose(twin: Twin, capture: Capture, *, identified: bool) -> Pose:
    """Pose of the object at the start of an episode.

    The offsets start_x, start_y [m] and start_yaw [rad], which were estimated, belong to the episode that the twin was
    identified from, and are used for it only.

    Args:
        twin: The twin.
        capture: The capture of the episode.
        identified: Whether the twin was identified from that episode; see `is_identified_episode`.

    Returns:
        X_WO; q (4,), p (3,) [m].
    """
    X_WO = capture.object.X_WO
    if not identified:
        return X_WO
    x, y, yaw = (_nuisance(twin, key) for key in ("start_x", "start_y", "start_yaw"))
    turn = quaternion_exp(torch.tensor([0.0, 0.0, yaw], dtype=torch.float64))
    return Pose(quaternion_multiply(turn, X_WO.q), X_WO.p + torch.tensor([x, y, 0.0], dtype=torch.float64))


def time_offset(twin: Twin, *, identified: bool) -> float:
    """Delay of an episode's frames against the robot's clock [s]; 0 where it is not known.

    Args:
        twin: The twin.
        identified: Whether the episode is the one that the twin was identified from.
    """
    return _nuisance(twin, "time_offset") if identified else 0.0


def _nuisance(twin: Twin, key: str) -> float:
    return twin.nuisance[key].value if key in twin.nuisance else 0.0
