"""The object of a capture: its name, mesh and pose, from `capture.yaml`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.capture.documents import Entry, read_yaml
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.poses import Pose

SCHEMA_VERSION = 1
CAPTURE_FILE = "capture.yaml"
_UNITS = {"length": "m", "angle": "rad", "time": "s"}
# How far a quaternion may be from unit norm: that of one printed with six digits.
_UNIT_NORM = 1e-5


@dataclass(frozen=True, eq=False)
class CaptureObject:
    """The object that a capture shows.

    Attributes:
        name: Its name.
        mesh_path: Its mesh, metres, object frame O.
        X_WO: Its pose in the world in the static views and at the start of an episode; q (4,), p (3,) [m].
    """

    name: str
    mesh_path: Path
    X_WO: Pose


def read_capture_object(folder: Path) -> CaptureObject:
    """Reads what `capture.yaml` says about the object.

    Args:
        folder: The capture.

    Returns:
        The object.

    Raises:
        InputError: The file is missing or no YAML, of another schema version or in other units, a key is
            missing, a number is not finite, or the quaternion is not of unit norm.
    """
    document = read_yaml(folder / CAPTURE_FILE)
    version = document["schema_version"]
    if version.value != SCHEMA_VERSION or isinstance(version.value, bool):
        raise version.refusal(f"{SCHEMA_VERSION}, the version that this release reads")
    units = document.find("units")
    for name, unit in _UNITS.items() if units is not None else ():
        entry = units.find(name) if units is not None else None
        if entry is not None and entry.value != unit:
            raise entry.refusal(unit)
    about = document["object"]
    mesh_path = folder / about["mesh"].text()
    if not mesh_path.is_file():
        raise InputError(mesh_path, value="no such file", allowed=f"the mesh that {CAPTURE_FILE} names")
    return CaptureObject(name=about["name"].text(), mesh_path=mesh_path, X_WO=read_pose(about["X_WO"]))


def read_pose(entry: Entry) -> Pose:
    """A pose from its keys p [m] and q (wxyz).

    Raises:
        InputError: A key is missing, a number is not finite, or q is not of unit norm.
    """
    q, p = entry["q"].numbers(4), entry["p"].numbers(3)
    norm = float(np.linalg.norm(q))
    if abs(norm - 1) > _UNIT_NORM:
        raise entry["q"].refusal("a quaternion (w, x, y, z) of norm 1", f"{q.tolist()}, of norm {norm:.6g}")
    return Pose(torch.from_numpy(q / norm), torch.from_numpy(p))
