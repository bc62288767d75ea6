"""Object of a capture: its name, mesh and pose, from `capture.yaml`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.capture.paths import require_file
from pinwm_drake.capture.tables import UNIT_NORM
from pinwm_drake.documents import Entry, read_yaml
from pinwm_drake.spatial.poses import Pose

SCHEMA_VERSION = 1
CAPTURE_FILE = "capture.yaml"
UNITS = {"length": "m", "angle": "rad", "time": "s"}
FARTHEST = 1e3  # m; anything beyond this on an axis is taken for a mistake
_MASS = (1e-6, 1e4)  # kg


@dataclass(frozen=True, eq=False)
class CaptureObject:
    """The object that a capture shows.

    Attributes:
        name: Name of the object.
        mesh_path: File of its mesh, metres, object frame O.
        X_WO: Pose of the object in the world in the static views and at the start of an episode; q (4,), p (3,) [m].
        mass: kg; None where it was not measured.
    """

    name: str
    mesh_path: Path
    X_WO: Pose
    mass: float | None = None


def read_capture_object(folder: Path) -> CaptureObject:
    """Reads the object of a capture from its `capture.yaml`.

    Args:
        folder: The capture.

    Returns:
        The object.

    Raises:
        InputError: The file is missing or no YAML, of another schema version or in other units, a key is
            missing, a number is not finite, or the quaternion is not of unit norm.
    """
    document = read_yaml(folder / CAPTURE_FILE)
    require_version(document)
    return read_object(document["object"])


def require_version(document: Entry) -> None:
    """Requires a `capture.yaml` of the version that this release reads, in SI units.

    Raises:
        InputError: It is of another version, or in other units.
    """
    version = document["schema_version"]
    if version.value != SCHEMA_VERSION or isinstance(version.value, bool):
        raise version.refusal(f"{SCHEMA_VERSION}, the version that this release reads")
    units = document.find("units")
    if units is None:
        return
    units.only(*UNITS)
    for name, unit in UNITS.items():
        entry = units.find(name)
        if entry is not None and entry.value != unit:
            raise entry.refusal(unit)


def read_object(about: Entry) -> CaptureObject:
    """The object from the key `object` of a `capture.yaml`.

    Raises:
        InputError: A key is missing or unknown, a number is not finite or out of range, or the mesh is missing.
    """
    about.only("name", "mesh", "mass", "X_WO")
    return CaptureObject(about["name"].text(), read_mesh_path(about), read_pose(about["X_WO"]), read_mass(about))


def read_mesh_path(about: Entry) -> Path:
    """The object's mesh, which has to be there.

    Raises:
        InputError: It is not named, or missing.
    """
    return require_file(about.path.parent / about["mesh"].text(), f"the mesh that {CAPTURE_FILE} names")


def read_mass(about: Entry) -> float | None:
    """The object's mass [kg], or None where it was not measured.

    Raises:
        InputError: It is not finite, or out of range.
    """
    mass = about.find("mass")
    return None if mass is None or mass.value is None else mass.number(*_MASS)


def read_pose(entry: Entry) -> Pose:
    """A pose from its keys p [m] and q (wxyz).

    Raises:
        InputError: A key is missing, a number is not finite, or q is not of unit norm.
    """
    entry.only("p", "q")
    q, p = entry["q"].numbers(4), entry["p"].numbers(3)
    if np.abs(p).max() > FARTHEST:
        raise entry["p"].refusal(f"a position within {FARTHEST:g} m of the origin")
    with np.errstate(over="ignore"):
        norm = float(np.linalg.norm(q))
    if abs(norm - 1) > UNIT_NORM:
        raise entry["q"].refusal("a quaternion (w, x, y, z) of norm 1", f"{q.tolist()}, of norm {norm:.6g}")
    return Pose(torch.from_numpy(q / norm), torch.from_numpy(p))
