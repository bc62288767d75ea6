# SPDX-License-Identifier: MIT
"""Scene of a capture from its `capture.yaml`: the object, the pusher, the floor and gravity."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
import torch
from pydantic import AfterValidator, Field, ValidationInfo

from pinwm_drake.capture.paths import is_file, require_file
from pinwm_drake.documents import Document, Entry, FromList, Number, Text, finite, in_words, read_yaml, schema_version
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.poses import Pose

SCHEMA_VERSION = 1
CAPTURE_FILE = "capture.yaml"
EPISODES = "episodes"
UNITS = {"length": "m", "angle": "rad", "time": "s"}
FARTHEST = 1e3  # m; anything beyond this on an axis is taken for a mistake
UNIT_NORM = 1e-5  # how far a quaternion may be from unit norm: that of one printed with six digits
PusherKind = Literal["sphere", "capsule", "cylinder"]
PUSHER_KINDS: tuple[PusherKind, ...] = get_args(PusherKind)
GRAVITIES = (1e-3, 1e3)  # m/s^2
_SIZES = (1e-4, 5.0)  # m, of a pusher


@dataclass(frozen=True, eq=False)
class CaptureObject:
    """The object that a capture shows.

    Attributes:
        name: Name of the object.
        mesh_path: File of its mesh, metres, object frame O.
        X_WO: Pose of the object in the world in the static views and at the start of an episode; q (4,), p (3,) [m].
        mass: kg; None where it was not measured.
        mesh_error: m, standard deviation of the sides of the mesh from those of the object; 0 for an exact mesh.
    """

    name: str
    mesh_path: Path
    X_WO: Pose
    mass: float | None = None
    mesh_error: float = 0.0


@dataclass(frozen=True)
class PusherShape:
    """A pusher as a simple shape, its middle the origin of the pusher frame P.

    Attributes:
        kind: Kind of the shape; a capsule or cylinder stands along z of P.
        radius: m.
        length: m, of the straight part along z; 0 for a sphere.
    """

    kind: PusherKind
    radius: float
    length: float = 0.0


@dataclass(frozen=True, eq=False)
class PusherGeometry:
    """Geometry of a pusher: a shape, which wins where both are there, or a mesh; neither without episodes only."""

    mesh_path: Path | None  # m, pusher frame P
    shape: PusherShape | None


@dataclass(frozen=True, eq=False)
class Capture:
    """Capture without its images and tables.

    Attributes:
        folder: Folder of the capture.
        object: The object that it shows.
        pusher: The pusher of the object.
        floor_height: m, z of the floor in the world.
        gravity: m/s^2, downwards, along -z of the world.
        episode_names: The folders in `episodes`, sorted.
        station: SHA-256 of the `station.yaml` that it was recorded with; None where it names none.
    """

    folder: Path
    object: CaptureObject
    pusher: PusherGeometry
    floor_height: float
    gravity: float
    episode_names: list[str]
    station: str | None = None


def _unit(q: tuple[float, ...]) -> tuple[float, ...]:
    with np.errstate(over="ignore"):
        norm = float(np.linalg.norm(q))
    if abs(norm - 1) > UNIT_NORM:
        raise ValueError(f"a quaternion (w, x, y, z) of norm 1, not of norm {norm:.6g}")
    return tuple(part / norm for part in q)


_Coordinate = Annotated[float, in_words(f"a position within {FARTHEST:g} m of the origin", ge=-FARTHEST, le=FARTHEST)]


class PoseDocument(Document):
    """Pose in a document, from its keys p [m] and q (wxyz)."""

    p: Annotated[tuple[_Coordinate, _Coordinate, _Coordinate], FromList]
    q: Annotated[tuple[Number, Number, Number, Number], FromList, AfterValidator(_unit)]

    def pose(self) -> Pose:
        """Return the pose, its quaternion normalised: q (4,), p (3,) [m]."""
        return Pose(torch.tensor(self.q, dtype=torch.float64), torch.tensor(self.p, dtype=torch.float64))


class ObjectDocument(Document):
    """Key `object` of a `capture.yaml`; mass in kg."""

    name: Text
    mesh: Text
    mass: Annotated[float, finite(1e-6, 1e4)] | None = None
    mesh_error: Annotated[float, finite(0.0, 0.02)] = 0.0
    X_WO: PoseDocument


def _length(length: float | None, shape: ValidationInfo) -> float | None:
    if shape.data.get("kind") == "sphere" and length:
        raise ValueError("0 or none, for a sphere")
    if shape.data.get("kind", "sphere") != "sphere" and not _SIZES[0] <= (length or 0.0) <= _SIZES[1]:
        raise ValueError(f"a finite number from {_SIZES[0]:g} to {_SIZES[1]:g}")
    return length


class ShapeDocument(Document):
    """Shape of a pusher, m."""

    kind: PusherKind
    radius: Annotated[float, finite(*_SIZES)]
    length: Annotated[Number | None, AfterValidator(_length)] = Field(None, validate_default=True)

    def shape(self) -> PusherShape:
        """Return the shape that the keys describe."""
        return PusherShape(self.kind, self.radius, self.length or 0.0)


class PusherDocument(Document):
    """Key `pusher` of a document."""

    mesh: Text | None = None
    shape: ShapeDocument | None = None


class FloorDocument(Document):
    """Key `floor` of a document: height in the world, m."""

    height: Annotated[float, finite(-100.0, 100.0)]


class _Units(Document):
    length: Literal["m"] = "m"
    angle: Literal["rad"] = "rad"
    time: Literal["s"] = "s"


class HeadDocument(Document, extra="ignore"):
    """Keys of a `capture.yaml` that tell how to read the others."""

    schema_version: int = schema_version(SCHEMA_VERSION)
    units: _Units = _Units()


class _ObjectOnly(HeadDocument):
    object: ObjectDocument


class _UnfinishedObject(Document, extra="ignore"):
    mesh: Text | None = None
    X_WO: PoseDocument | None = None


class _Unfinished(HeadDocument):
    floor: FloorDocument = FloorDocument(height=0.0)
    object: _UnfinishedObject = _UnfinishedObject()
    pusher: PusherDocument = PusherDocument()


@dataclass(frozen=True, eq=False)
class UnfinishedCapture:
    """What is known of a capture that may lack its mesh, or its `capture.yaml`.

    Attributes:
        folder: Folder of the capture.
        floor_height: m; 0 where nothing tells it.
        mesh_path: File of the object's mesh, which may be missing; None where nothing names one.
        X_WO: Pose of the object that the file gives; or None.
        pusher: The pusher, of which nothing may be known; its mesh may be missing.
        episode_names: The folders in `episodes`, sorted.
    """

    folder: Path
    floor_height: float
    mesh_path: Path | None
    X_WO: Pose | None
    pusher: PusherGeometry
    episode_names: list[str]


def load_unfinished(capture: str | Path) -> UnfinishedCapture:
    """Read what is there of a capture that is being made.

    Raises:
        InputError: There is no such folder, or a key that is there is refused; see `load_capture`.
    """
    folder = Path(capture)
    if not folder.is_dir():
        raise InputError(folder, value="no such folder", allowed="a capture: a folder with static/transforms.json")
    found = read_yaml(folder / CAPTURE_FILE).read(_Unfinished) if is_file(folder / CAPTURE_FILE) else None
    found = found or _Unfinished(schema_version=SCHEMA_VERSION)
    mesh = found.object.mesh
    mesh_path = None if mesh is None else folder / mesh
    X_WO = None if found.object.X_WO is None else found.object.X_WO.pose()
    pusher = PusherGeometry(
        None if found.pusher.mesh is None else folder / found.pusher.mesh,
        None if found.pusher.shape is None else found.pusher.shape.shape(),
    )
    return UnfinishedCapture(folder, found.floor.height, mesh_path, X_WO, pusher, episode_names(folder))


class CaptureDocument(HeadDocument, extra="forbid"):
    """Keys of a `capture.yaml`, as its readers take them; gravity in m/s^2."""

    gravity: Annotated[float, finite(*GRAVITIES)]
    object: ObjectDocument
    pusher: PusherDocument
    floor: FloorDocument
    station: Annotated[str, in_words("64 hexadecimal digits, SHA-256", pattern="^[0-9a-f]{64}$")] | None = None


def read_capture_object(folder: Path) -> CaptureObject:
    """Read the object of a capture from its `capture.yaml`; keys beside that are not needed.

    Raises:
        InputError: As for `load_capture`.
    """
    document = read_yaml(folder / CAPTURE_FILE)
    return _object(folder, document.read(_ObjectOnly).object)


def load_capture(capture: str | Path) -> Capture:
    """Read `capture.yaml` of a folder, and the names of the episodes.

    Raises:
        InputError: The file is missing or no YAML, of another schema version or in other units, a key is
            missing or unknown, a number is not finite or out of range, a quaternion is not of unit norm, the
            pusher is of an unknown shape, or a mesh that it names is missing.
    """
    folder = Path(capture)
    entry = read_yaml(folder / CAPTURE_FILE)
    document = entry.read(CaptureDocument)
    about, names = _object(folder, document.object), episode_names(folder)
    pusher = pusher_geometry(entry["pusher"], document.pusher, required=bool(names))
    return Capture(folder, about, pusher, document.floor.height, document.gravity, names, document.station)


def _object(folder: Path, about: ObjectDocument) -> CaptureObject:
    return CaptureObject(about.name, object_mesh(folder, about.mesh), about.X_WO.pose(), about.mass, about.mesh_error)


def object_mesh(folder: Path, name: str) -> Path:
    """File of the object's mesh; raises InputError where it is missing."""
    return require_file(folder / name, f"the mesh that {CAPTURE_FILE} names")


def pusher_geometry(entry: Entry, pusher: PusherDocument, *, required: bool) -> PusherGeometry:
    """Return the pusher of a capture; raise InputError where a required one has no mesh, shape or file."""
    mesh_path = None if pusher.mesh is None else entry.path.parent / pusher.mesh
    if required and mesh_path is None and pusher.shape is None:
        raise entry.refusal("a mesh or a shape")
    if required and mesh_path is not None:
        require_file(mesh_path, f"the pusher's mesh that {CAPTURE_FILE} names")
    return PusherGeometry(mesh_path, None if pusher.shape is None else pusher.shape.shape())


def episode_names(folder: Path) -> list[str]:
    """Names of the folders in `episodes`, sorted; those that begin with a dot are left out.

    Raises:
        InputError: `episodes` cannot be listed, or a name cannot be printed.
    """
    episodes = folder / EPISODES
    try:
        if not episodes.exists():
            return []
        names = sorted(path.name for path in episodes.iterdir() if path.is_dir() and not path.name.startswith("."))
    except OSError as error:
        raise InputError(episodes, value=error.strerror, allowed="a folder of episodes") from error
    for name in names:
        if not name.isprintable():
            raise InputError(episodes, value=f"a folder {name!a}", allowed="names that can be printed")
    return names
