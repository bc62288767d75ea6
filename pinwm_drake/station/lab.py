# SPDX-License-Identifier: MIT
"""A lab's folder: `lab.yaml`, the photos of the board, and the robot's poses."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from pinwm_drake.capture.episode_tables import QUATERNION, Table, read_table
from pinwm_drake.capture.lens import LensModel
from pinwm_drake.capture.paths import is_folder, require_file
from pinwm_drake.capture.scene import PoseDocument, PusherDocument
from pinwm_drake.capture.static_views import is_picture
from pinwm_drake.documents import Document, FromList, Number, Text, finite, read_yaml, schema_version
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.reading.pictures import opened_picture
from pinwm_drake.station.board import DEFAULT_DICTIONARY, RULER, Board
from pinwm_drake.validation import Refusal

LAB_FILE, POSES_FILE = "lab.yaml", "robot.csv"
LENS, ROBOT, TABLE = SETS = ("lens", "robot", "table")
SCHEMA_VERSION = 1
Mount = Literal["fixed", "hand"]
_PLACE, _VECTOR, _ANGLES = ("x", "y", "z"), ("rx", "ry", "rz"), ("roll", "pitch", "yaw")
_LENGTHS, _TURNS = {"m": 1.0, "mm": 1e-3}, {"rad": 1.0, "deg": math.pi / 180.0}
_UNIT_NORM = 1e-2  # quaternions of a robot's log may have three digits
_FARTHEST, _NEAREST = 5.0, 0.02  # m: reach of a robot, and the least spread of its places
_Vector = Annotated[tuple[Number, Number, Number], FromList]
_Interval = Annotated[tuple[Number, Number], FromList]


def _in_order(value: "Range") -> "Range":
    for key in type(value).model_fields:
        ends = getattr(value, key)
        if ends is not None and any(low > high for low, high in zip(*_ends(ends), strict=True)):
            raise Refusal("numbers [low, high] with low <= high", key)
    return value


def _ends(ends: tuple[float, float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    return (ends[0],), (ends[1],)


class Range(Document):
    """Base of documents whose values are intervals [low, high]."""

    @model_validator(mode="after")
    def _check(self) -> "Range":
        return _in_order(self)


class WorkspaceDocument(Document):
    """Box in which the object is pushed: lowest and highest corner, W, m."""

    low: _Vector
    high: _Vector

    @model_validator(mode="after")
    def _check(self) -> "WorkspaceDocument":
        if any(not 0.0 < high - low <= 10.0 for low, high in zip(self.low, self.high, strict=True)):
            raise Refusal("a corner above that of low, by up to 10 m on each axis", "high")
        return self

    def points(self, number: int = 5) -> np.ndarray:
        """Grid of points (number^2 * 3, 3) [m] in the box, W."""
        axes = [np.linspace(low, high, number) for low, high in zip(self.low, self.high, strict=True)]
        axes[2] = np.linspace(self.low[2], self.high[2], 3)
        return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


class ViewDocument(Document):
    """View that policies see: the point looked at, W, m; the angle of view, rad; and the size, px."""

    p_WT: _Vector
    fov_y: Annotated[float, finite(0.01, 3.0)]
    size: Annotated[tuple[Annotated[int, Field(ge=8, le=4096)], Annotated[int, Field(ge=8, le=4096)]], FromList]


class LatencyDocument(Range):
    """Delays as intervals, s: of images behind the robot's clock, and of the robot behind commands."""

    camera: _Interval | None = None
    robot: _Interval | None = None


class StartDocument(Range):
    """Range of starts: place of the object, W, m, and its yaw, rad."""

    x: _Interval
    y: _Interval
    yaw: _Interval


class OffsetDocument(Document):
    """Constant offset between the frames of robot and camera: m, m and rad."""

    x: Number
    y: Number
    yaw: Number


class ToolDocument(PusherDocument):
    """Pusher with its pose X_EP in the gripper, and the offset of the frames of robot and camera."""

    X_EP: PoseDocument | None = None
    offset: OffsetDocument | None = None


class CameraDocument(Document):
    """Rate of a camera, 1/s, and how it exposes."""

    rate: Annotated[float, finite(0.01, 1e4)] | None = None
    shutter: Literal["global", "rolling"] | None = None


class _Board(Document):
    squares: Annotated[tuple[int, int], FromList] = Board().squares
    square: Annotated[float, finite(1e-3, 1.0)] = Board().square
    marker: Annotated[float, finite(1e-3, 1.0)] = Board().marker
    dictionary: Text = DEFAULT_DICTIONARY
    thickness: Annotated[float, finite(0.0, 0.1)] = 0.0


class _Robot(Document):
    length: Literal["m", "mm"]
    angle: Literal["rad", "deg"] | None = None


class LabDocument(Document):
    """Contents of a `lab.yaml`; lengths in m."""

    schema_version: int = schema_version(SCHEMA_VERSION)
    name: Text | None = None
    ruler: Annotated[float, finite(0.8 * RULER, 1.2 * RULER)]
    reading: Annotated[float, finite(1e-5, 5e-3)] = 2e-4  # largest error of the ruler's reading
    board: _Board = _Board()
    lens: LensModel = "opencv"
    mount: Mount = "fixed"
    robot: _Robot
    workspace: WorkspaceDocument
    camera: CameraDocument = CameraDocument()
    view: ViewDocument | None = None
    latency: LatencyDocument = LatencyDocument()
    tool: ToolDocument = ToolDocument()
    start: StartDocument | None = None

    @property
    def scale_noise(self) -> float:
        """Standard deviation of the board's scale by the ruler: of errors that are equally likely up to `reading`."""
        return self.reading / math.sqrt(3.0) / self.ruler

    def printed_board(self) -> Board:
        """Board with the sides that it was printed with, by the ruler's reading.

        Raises:
            ParameterError: Its numbers do not go together.
        """
        scale, board = self.ruler / RULER, self.board
        return Board(board.squares, scale * board.square, scale * board.marker, board.dictionary)


@dataclass(frozen=True, eq=False)
class LabPhoto:
    """Photo of the board in a lab's folder.

    Attributes:
        name: Its path from the folder, as robot.csv has it.
        kind: The set: "lens", "robot" or "table".
        path: The file.
        X_BE: (4, 4), pose of the gripper in the robot's base as the robot told it; None where it told none.
    """

    name: str
    kind: str
    path: Path
    X_BE: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Lab:
    """A lab's folder: its document, and its photos in the order of sets and names."""

    folder: Path
    document: LabDocument
    photos: list[LabPhoto]


def load_lab(folder: Path) -> Lab:
    """Read the `lab.yaml` of a folder, list its photos and read the robot's poses.

    Raises:
        InputError: A file is missing or wrong, or a photo has no pose; the message names file and row.
    """
    entry = read_yaml(require_file(folder / LAB_FILE, "the lab's lab.yaml; see docs/how-to/calibrate-a-station.md"))
    document = entry.read(LabDocument)
    try:
        document.printed_board()
    except ParameterError as error:
        raise InputError(entry.path, value=error, allowed="the board as it was printed") from error
    poses = read_poses(folder / POSES_FILE, document.robot.length, document.robot.angle)
    photos = []
    for kind in SETS:
        for path in photos_in(folder / kind):
            name = f"{kind}/{path.name}"
            if name not in poses and (kind == ROBOT or (kind == TABLE and document.mount == "hand")):
                raise InputError(folder / POSES_FILE, value=f"no row of {name}", allowed="a row for each photo of it")
            photos.append(LabPhoto(name, kind, path, poses.get(name)))
    names = {photo.name for photo in photos}
    for name in poses:
        if name not in names:
            raise InputError(folder / POSES_FILE, value=f"a row of {name}, which is not there", allowed="photos there")
    return Lab(folder, document, photos)


def photos_in(folder: Path) -> list[Path]:
    """Photos in a folder, in the order of their names; none where there is no folder.

    Raises:
        InputError: Two names differ in their suffix only, or in case: what is written for one would replace the other.
    """
    found, seen = folder.glob("*") if is_folder(folder) else (), dict[str, Path]()
    paths = sorted(path for path in found if is_picture(path))
    for path in paths:
        other = seen.setdefault(path.stem.casefold(), path)
        if other is not path:
            raise InputError(folder, value=f"{other.name} and {path.name}", allowed="names that differ without suffix")
    return paths


def read_grey(path: Path) -> np.ndarray:
    """Pixels (height, width) uint8 of a photo; raises InputError where it cannot be read."""
    with opened_picture(path) as image:
        return np.asarray(image.convert("L"))


def read_poses(path: Path, length: str, angle: str | None) -> dict[str, np.ndarray]:
    """Poses X_BE (4, 4) of the gripper by the names of their photos.

    Columns are `file`, `x`, `y`, `z`, and a rotation: `qw` to `qz`; or `rx`, `ry`, `rz`, a rotation vector; or `roll`,
    `pitch`, `yaw` about the fixed axes x, y, z in turn.

    Args:
        path: The file.
        length: Unit of x, y and z: "m" or "mm".
        angle: Unit of angles, "rad" or "deg"; None where there are none.

    Raises:
        InputError: A column is missing, a number is not finite or out of range, or the places do not fit the unit.
    """
    require_file(path, "the robot's poses; see docs/how-to/calibrate-a-station.md")
    columns = ("file", *_PLACE)
    first, *forms = ((*columns, *kind) for kind in (QUATERNION, _VECTOR, _ANGLES))
    table = read_table(path, first, forms=tuple(forms), gaps=True)
    if QUATERNION[0] in table.cells:
        turns = Rotation.from_quat(table.quaternions(_UNIT_NORM), scalar_first=True)
    elif angle is None:
        raise InputError(path.with_name(LAB_FILE), value="no robot.angle", allowed="rad or deg under robot.angle")
    elif _VECTOR[0] in table.cells:
        turns = Rotation.from_rotvec(_angles(table, _VECTOR, _TURNS[angle]))
    else:
        turns = Rotation.from_euler("xyz", _angles(table, _ANGLES, _TURNS[angle]))
    places = _LENGTHS[length] * table.numbers(_PLACE)
    row, axis = np.unravel_index(np.abs(places).argmax(), places.shape)
    if (far := abs(places[row, axis])) > _FARTHEST:
        hint = "; are these mm? then robot.length: mm" if far < 1e3 * _FARTHEST else ""
        raise table.refusal(int(row), _PLACE[axis], f"{_FARTHEST:g} m at most{hint}")
    names = [name.strip() for name in table.cells["file"]]
    seen: dict[str, int] = {}
    for k, name in enumerate(names):
        if seen.setdefault(name, k) != k:
            raise table.refusal(k, "file", f"each photo once (it is in row {table.lines[seen[name]]} too)")
    if len(names) > 1 and np.ptp(places, axis=0).max() < _NEAREST:
        found = f"places within {1e3 * np.ptp(places, axis=0).max():.2g} mm of each other"
        raise InputError(path, value=found, allowed="0.02 m or more; are these m? then robot.length: m")
    X = np.tile(np.eye(4), (len(names), 1, 1))
    X[:, :3, :3], X[:, :3, 3] = turns.as_matrix(), places
    return dict(zip(names, X, strict=True))


def _angles(table: Table, columns: tuple[str, ...], unit: float) -> np.ndarray:
    """Angles (rows, 3) [rad] of up to two turns."""
    angles = unit * table.numbers(columns)
    row, axis = np.unravel_index(np.abs(angles).argmax(), angles.shape)
    if abs(angles[row, axis]) > 4.0 * math.pi:
        raise table.refusal(int(row), columns[axis], "two turns at most; see robot.angle")
    return angles
