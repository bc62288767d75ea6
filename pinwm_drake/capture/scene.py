"""Scene of a capture from its `capture.yaml`: the object, the pusher, the floor and gravity."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pinwm_drake.capture.objects import CAPTURE_FILE, CaptureObject, read_object, require_version
from pinwm_drake.capture.paths import require_file
from pinwm_drake.documents import Entry, read_yaml
from pinwm_drake.errors import InputError

EPISODES = "episodes"
PusherKind = Literal["sphere", "capsule", "cylinder"]
PUSHER_KINDS = ("sphere", "capsule", "cylinder")
_SIZES = (1e-4, 5.0)  # m, of a pusher
_HEIGHTS = (-100.0, 100.0)  # m, of a floor
_GRAVITIES = (1e-3, 1e3)  # m/s^2


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
    """Geometry of a pusher: a shape, which wins where both are there, or a mesh.

    Attributes:
        mesh_path: File of the mesh, metres, pusher frame P; or None.
        shape: The shape; or None. Both are None in captures without episodes only.
    """

    mesh_path: Path | None
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
    """

    folder: Path
    object: CaptureObject
    pusher: PusherGeometry
    floor_height: float
    gravity: float
    episode_names: list[str]


def read_capture(folder: Path) -> Capture:
    """Reads `capture.yaml`, and the names of the episodes.

    Args:
        folder: The capture.

    Returns:
        The capture.

    Raises:
        InputError: The file is missing or no YAML, of another schema version or in other units, a key is
            missing or unknown, a number is not finite or out of range, a quaternion is not of unit norm, the
            pusher is of an unknown shape, or a mesh that it names is missing.
    """
    document = read_yaml(folder / CAPTURE_FILE)
    require_version(document)
    document.only("schema_version", "units", "gravity", "object", "pusher", "floor")
    about = read_object(document["object"])
    names = episode_names(folder)
    pusher = read_pusher(document["pusher"], required=bool(names))
    return Capture(folder, about, pusher, read_floor(document["floor"]), read_gravity(document["gravity"]), names)


def read_floor(floor: Entry) -> float:
    """Height of the floor [m] from the key `floor`.

    Raises:
        InputError: It is missing, or out of range.
    """
    floor.only("height")
    return floor["height"].number(*_HEIGHTS)


def read_gravity(gravity: Entry) -> float:
    """Gravity [m/s^2] from the key `gravity`.

    Raises:
        InputError: It is not finite, or out of range.
    """
    return gravity.number(*_GRAVITIES)


def read_pusher(pusher: Entry, *, required: bool) -> PusherGeometry:
    """The pusher from the key `pusher`.

    Args:
        pusher: The entry.
        required: Whether there has to be a mesh or a shape.

    Raises:
        InputError: A key is unknown, the shape is of an unknown kind or out of range, the mesh is missing, or
            there is neither.
    """
    pusher.only("mesh", "shape")
    mesh, shape = pusher.find("mesh"), pusher.find("shape")
    mesh_path = None if mesh is None or mesh.value is None else pusher.path.parent / mesh.text()
    about = None if shape is None or shape.value is None else read_shape(shape)
    if required and mesh_path is None and about is None:
        raise pusher.refusal("a mesh or a shape")
    if required and mesh_path is not None:
        require_file(mesh_path, f"the pusher's mesh that {CAPTURE_FILE} names")
    return PusherGeometry(mesh_path, about)


def read_shape(shape: Entry) -> PusherShape:
    """Shape of a pusher from the entry `shape`.

    Raises:
        InputError: Its kind is unknown, or a size is missing or out of range.
    """
    shape.only("kind", "radius", "length")
    kind = shape["kind"]
    if kind.value not in PUSHER_KINDS:
        raise kind.refusal(", ".join(PUSHER_KINDS))
    radius, length = shape["radius"].number(*_SIZES), shape.find("length")
    if kind.value == "sphere":
        if length is not None and length.value is not None and length.number() != 0:
            raise length.refusal("0 or none, for a sphere")
        return PusherShape("sphere", radius)
    return PusherShape(kind.value, radius, shape["length"].number(*_SIZES))


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
