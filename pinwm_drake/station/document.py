# SPDX-License-Identifier: MIT
"""The document of a station, `station.yaml`: written whole or not at all, and read by one reader."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from pinwm_drake.capture.lens import DISTORTIONS, Lens, LensModel
from pinwm_drake.capture.scene import PoseDocument
from pinwm_drake.documents import Document, Entry, FromList, Number, Text, finite, in_words, schema_version, yaml_text
from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.reading.trees import MOST_YAML, parse_yaml
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.station.lab import (
    CameraDocument,
    LatencyDocument,
    Mount,
    StartDocument,
    ToolDocument,
    ViewDocument,
    WorkspaceDocument,
)
from pinwm_drake.station.named import station_file
from pinwm_drake.validation import Refusal

SCHEMA_VERSION = 1
_Interval = Annotated[tuple[Number, Number], FromList]
_Row = Annotated[tuple[Number, ...], FromList]
_Size = Annotated[int, Field(ge=1, le=16384)]
_Hash = Annotated[str, in_words("64 hexadecimal digits", pattern="^[0-9a-f]{64}$")]


class _Units(Document):
    length: Literal["m"] = "m"
    angle: Literal["rad"] = "rad"
    time: Literal["s"] = "s"


class TableDocument(Document):
    """Table: z in W, m, and its tilt against the robot's base, rad; with 95 % intervals."""

    height: Annotated[float, finite(-100.0, 100.0)]
    height_interval: _Interval | None = None
    tilt: Annotated[float, finite(0.0, 1.6)]
    tilt_interval: _Interval | None = None


class WorldDocument(Document):
    """World W in the robot's base B, and the table."""

    X_BW: PoseDocument
    table: TableDocument


class StationCameraDocument(CameraDocument):
    """Camera of a station: px, m; see `docs/reference/formats/station.md`."""

    mount: Mount
    size: Annotated[tuple[_Size, _Size], FromList]
    model: LensModel
    K: Annotated[tuple[_Row, _Row, _Row], FromList]
    distortion: _Row
    X_WC: PoseDocument | None = None
    X_EC: PoseDocument | None = None
    covariance: Annotated[tuple[_Row, ...], FromList] | None = None

    @model_validator(mode="after")
    def _check(self) -> "StationCameraDocument":
        K = self.K
        rows = [len(row) for row in K] == [3, 3, 3] and K[0][1] == K[1][0] == 0.0 and K[2] == (0.0, 0.0, 1.0)
        if not rows or min(K[0][0], K[1][1]) <= 0.0:
            raise Refusal("[fx, 0, cx], [0, fy, cy], [0, 0, 1] with fx and fy above 0", "K")
        if len(self.distortion) not in DISTORTIONS[self.model]:
            allowed = " or ".join(map(str, DISTORTIONS[self.model]))
            raise Refusal(f"{allowed} numbers for {self.model}", "distortion")
        needed, other = ("X_WC", "X_EC") if self.mount == "fixed" else ("X_EC", "X_WC")
        if getattr(self, needed) is None or getattr(self, other) is not None:
            raise Refusal(f"{self.mount} with {needed} and without {other}", "mount")
        size = 4 + len(self.distortion) + 6
        if self.covariance is not None and [len(row) for row in self.covariance] != [size] * size:
            raise Refusal(f"{size} x {size} numbers", "covariance")
        return self

    def lens(self) -> Lens:
        """Return the lens."""
        (fx, _, cx), (_, fy, cy), _ = self.K
        return Lens(*self.size, self.model, np.array([fx, fy, cx, cy]), np.array(self.distortion))


class AccuracyDocument(Document):
    """Distances within which a point of the workspace is seen, 95 %: of the median and the worst point, m."""

    median: Annotated[float, finite(0.0, 100.0)]
    worst: Annotated[float, finite(0.0, 100.0)]


class StationDocument(Document):
    """Contents of a `station.yaml`; SI and radians."""

    schema_version: int = schema_version(SCHEMA_VERSION)
    units: _Units = _Units()
    name: Text
    world: WorldDocument
    camera: StationCameraDocument
    view: ViewDocument | None = None
    latency: LatencyDocument = LatencyDocument()
    tool: ToolDocument = ToolDocument()
    workspace: WorkspaceDocument
    start: StartDocument | None = None
    accuracy: AccuracyDocument | None = None
    provenance: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Station:
    """Station of a lab.

    Attributes:
        path: The file.
        sha256: Hash of the file, by which captures, twins and bundles name their station.
        document: Contents of the file.
    """

    path: Path
    sha256: str
    document: StationDocument

    @property
    def lens(self) -> Lens:
        """Lens of the camera."""
        return self.document.camera.lens()

    @property
    def X_WC(self) -> Pose:
        """Pose of a fixed camera in W, OpenCV axes: q (4,), p (3,) [m]; InputError for one in the hand."""
        fixed = self.document.camera.X_WC
        if fixed is None:
            raise InputError(self.path, value="a camera in the hand", allowed="a fixed camera, camera.mount: fixed")
        return fixed.pose()


def load_station(path: Path) -> Station:
    """Read a station from its `station.yaml`, or from the folder with it.

    Raises:
        InputError: The file is missing or no YAML, a key is missing or unknown, or a value is out of range.
    """
    file = station_file(path)
    content = read_bytes(file, MOST_YAML)
    document = Entry(file, "", parse_yaml(content, file)).read(StationDocument)
    return Station(file, hashlib.sha256(content).hexdigest(), document)


def write_station(path: Path, document: StationDocument) -> Station:
    """Write a station, and return it as it is read again.

    Raises:
        InputError: The file cannot be written.
    """
    plain = document.model_dump(mode="json")
    prepare_folder(path.parent)
    with replacing(path) as temporary:
        temporary.write_text(yaml_text(plain), encoding="utf-8", newline="")
    return load_station(path)
