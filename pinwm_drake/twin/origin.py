# SPDX-License-Identifier: MIT
"""Origin of a twin: the episodes that it was identified from, and how they start."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from pinwm_drake.capture.episode_tables import POSES_FILE
from pinwm_drake.capture.episodes import Episode
from pinwm_drake.capture.ground_truth import GROUND_TRUTH_FILE
from pinwm_drake.capture.scene import Capture
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.spatial.poses import Pose, compose
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_multiply
from pinwm_drake.twin.twin import Twin

# The truth, where a capture has it, is no part of what a twin is made from; measured poses have a hash of their own.
_LEFT_OUT = (POSES_FILE, GROUND_TRUTH_FILE)
_SIZES = (("q", 4), ("p", 3))


@dataclass(frozen=True)
class Origin:
    """Capture, its hash by `hash_capture`, and the episodes that a twin was identified from; its station, if known."""

    path: Path
    sha256: str
    episodes: tuple[str, ...]
    station: str | None = None  # SHA-256 of its station.yaml

    @staticmethod
    def of(capture: Capture, episodes: Sequence[Episode]) -> "Origin":
        """Return the origin of a twin that is identified now; raises InputError where a file cannot be read."""
        names = tuple(episode.name for episode in episodes)
        return Origin(capture.folder.resolve(), hash_capture(capture.folder, names), names, capture.station)

    @staticmethod
    def read(twin: Twin) -> "Origin | None":
        """Origin from the provenance of a twin; None where that does not say all of it."""
        path, sha256 = (twin.provenance.get(key) for key in ("capture", "capture_sha256"))
        # Twins of one episode name it by itself, as those of older releases do.
        names = twin.provenance.get("episodes", [twin.provenance.get("episode")])
        if not isinstance(names, list) or not names:
            return None
        if not all(isinstance(value, str) and value for value in (path, sha256, *names)):
            return None
        station = twin.provenance.get("station")
        return Origin(Path(str(path)), str(sha256), tuple(names), station if isinstance(station, str) else None)

    def to_provenance(self) -> dict[str, Any]:
        """Return the entries of a twin's provenance that `read` looks for."""
        of = {"episode": self.episodes[0]} if len(self.episodes) == 1 else {"episodes": list(self.episodes)}
        told = {} if self.station is None else {"station": self.station}
        return {"capture": str(self.path), "capture_sha256": self.sha256, **of, **told}


def hash_capture(folder: Path, episodes: Sequence[str]) -> str:
    """SHA-256 of all files of a capture that a twin is made from: names and contents, in the order of the names.

    Ground truth and other episodes than the named ones do not count. Raises InputError where a file cannot be read.
    """
    parts = ("meshes", "static", *(f"episodes/{episode}" for episode in episodes))
    files = [folder / "capture.yaml"]
    for path in (path for part in parts for path in (folder / part).rglob("*")):
        hidden = any(name.startswith(".") for name in path.relative_to(folder).parts)
        if path.is_file() and not hidden and path.name not in _LEFT_OUT:
            files.append(path)
    digest = hashlib.sha256()
    for path in sorted(files):
        contents = hashlib.sha256(read_bytes(path)).hexdigest()
        digest.update(f"{path.relative_to(folder).as_posix()}\n{contents}\n".encode("utf-8", "surrogateescape"))
    return digest.hexdigest()


def identified_push(twin: Twin, capture: Capture, episode: Episode) -> int | None:
    """Return the number of the push that an episode was in a twin's identification, or None.

    Raises:
        InputError: A file of the capture cannot be read.
    """
    origin = Origin.read(twin)
    if origin is None or episode.name not in origin.episodes:
        return None
    known = all(name in capture.episode_names for name in origin.episodes)
    same = known and origin.sha256 == hash_capture(capture.folder, origin.episodes)
    return origin.episodes.index(episode.name) if same else None


def seen_in(capture: Capture, X_OS: Pose) -> Capture:
    """Return the capture with the object where its static views show it, X_OS against the pose that is written."""
    return replace(capture, object=replace(capture.object, X_WO=compose(capture.object.X_WO, X_OS)))


def registration_entry(written: Pose, seen: Pose) -> dict[str, Any]:
    """Return the entry of a twin's provenance that `seen_start` looks for: poses X_WO that are written and seen."""
    poses = {"written": written, "seen": seen}
    return {"start": {name: {"q": X.q.tolist(), "p": X.p.tolist()} for name, X in poses.items()}}


def seen_start(twin: Twin, capture: Capture) -> Pose:
    """Pose X_WO of the object at the start of a capture's episodes: as its static views show it, where that is known.

    A twin knows where the static views of its own capture have the object.
    """
    X_WO, known = capture.object.X_WO, twin.provenance.get("start")
    if not isinstance(known, dict):
        return X_WO
    try:
        written, seen = (
            Pose(*(torch.tensor(known[name][key], dtype=torch.float64).reshape(size) for key, size in _SIZES))
            for name in ("written", "seen")
        )
    except (KeyError, TypeError, ValueError, RuntimeError):
        return X_WO  # a twin that does not say all of it, as for `Origin.read`
    same = torch.allclose(written.q, X_WO.q, atol=1e-9) and torch.allclose(written.p, X_WO.p, atol=1e-9)
    return seen if same else X_WO


def start_pose(twin: Twin, capture: Capture, push: int | None, episode: Episode | None = None) -> Pose:
    """Pose of the object at the start of an episode; of one that has its own, in `start.yaml`, that.

    The offsets start_x, start_y [m] and start_yaw [rad], which were estimated, belong to a push that the twin was
    identified from, and are used for it only: that of a number, see `identified_push`, or None for another one.
    """
    own = None if episode is None else episode.start
    X_WO = seen_start(twin, capture) if own is None else own
    if push is None:
        return X_WO
    x, y, yaw = (of_push(twin, key, push, 0.0) for key in ("start_x", "start_y", "start_yaw"))
    turn = quaternion_exp(torch.tensor([0.0, 0.0, yaw], dtype=torch.float64))
    return Pose(quaternion_multiply(turn, X_WO.q), X_WO.p + torch.tensor([x, y, 0.0], dtype=torch.float64))


def time_offset(twin: Twin, push: int | None) -> float:
    """Delay of the frames of an identified push against the robot's clock [s]; 0 where it is not known."""
    return 0.0 if push is None else of_push(twin, "time_offset", push, 0.0)


def in_push(twin: Twin, push: int | None) -> Twin:
    """Return the twin with the frictions of an identified push, by `grip_floor` and `grip_pusher`."""
    if push is None:
        return twin
    factors = {f"friction_{one}": of_push(twin, f"grip_{one}", push, 1.0) for one in ("floor", "pusher")}
    theta = {name: replace(one, value=one.value * factors.get(name, 1.0)) for name, one in twin.theta.items()}
    draws = twin.draws
    if draws is not None:
        draws = replace(draws, values=draws.values * [factors.get(name, 1.0) for name in draws.names])
    return replace(twin, theta=theta, draws=draws)


def of_push(twin: Twin, name: str, push: int, otherwise: float) -> float:
    """Value of a nuisance of one identified push, by its name, or with the push's number after it."""
    found = twin.nuisance.get(f"{name}.{push}", twin.nuisance.get(name))
    return otherwise if found is None else found.value
