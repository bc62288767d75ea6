# SPDX-License-Identifier: MIT
"""Folder of a lab: where each stage has its files, and the scene of its capture."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pinwm_drake.capture.amend import amend
from pinwm_drake.capture.scene import CAPTURE_FILE, SCHEMA_VERSION, UNITS
from pinwm_drake.capture.static_views import TRANSFORMS, is_picture
from pinwm_drake.documents import Document, Text, finite, read_yaml, schema_version
from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder
from pinwm_drake.station.document import Station, load_station
from pinwm_drake.station.lab import LAB_FILE, LabDocument
from pinwm_drake.station.named import STATION_FILE

OBJECT_FILE, BOARD_FILE = "object.yaml", "board.pdf"
_MESHES = (".obj", ".stl", ".ply", ".off", ".glb")
_GRAVITY = 9.81
FOUND = ("X_WO", "mesh_error")  # keys of the object that stages find and write
_OF_PERSON = ("schema_version", "units", "gravity")  # keys that stay as they are


class ObjectDocument(Document):
    """Contents of an `object.yaml`: name, mass [kg], and the map of the columns of logs."""

    schema_version: int = schema_version(1)
    name: Text
    mass: Annotated[float, finite(1e-6, 1e4)] | None = None
    columns: Annotated[str, "may be empty"] = ""


@dataclass(frozen=True)
class LabFolder:
    """Folder of a lab, with the places of its files."""

    path: Path

    @property
    def station(self) -> Path:
        """File of the station."""
        return self.path / "station" / STATION_FILE

    @property
    def photos(self) -> Path:
        """Folder of the object's photos."""
        return self.path / "photos"

    @property
    def capture(self) -> Path:
        """Folder of the capture."""
        return self.path / "capture"

    @property
    def static(self) -> Path:
        """Folder of the static views."""
        return self.capture / "static"

    @property
    def transforms(self) -> Path:
        """File with the poses of the static views."""
        return self.static / TRANSFORMS

    @property
    def scene(self) -> Path:
        """File of the capture's scene."""
        return self.capture / CAPTURE_FILE

    @property
    def mesh(self) -> Path:
        """File of the object's mesh."""
        return self.capture / "meshes/object.obj"

    @property
    def twin(self) -> Path:
        """Folder of the twin."""
        return self.path / "twin"

    @property
    def first(self) -> Path:
        """Folder of the push that is proposed before any was filmed."""
        return self.path / "first"

    @property
    def next(self) -> Path:
        """Folder of the proposed push."""
        return self.path / "next"

    @property
    def policy(self) -> Path:
        """Folder of the policy."""
        return self.path / "policy"

    @property
    def cad(self) -> Path | None:
        """CAD file or scan in `mesh`; None without one.

        Raises:
            InputError: There are several.
        """
        found = sorted(path for path in (self.path / "mesh").glob("*") if path.suffix.lower() in _MESHES)
        if len(found) > 1:
            raise InputError(found[1], value=f"{found[0].name} beside it", allowed="one CAD file or scan in mesh/")
        return found[0] if found else None

    @property
    def pushes(self) -> list[Path]:
        """Folders below `pushes` that hold something."""
        return [path for path in sorted((self.path / "pushes").glob("*")) if path.is_dir() and any(path.iterdir())]

    def pictures(self, *folders: str) -> list[Path]:
        """Pictures in folders of the lab, in the order of their names, those of each folder together."""
        return [path for name in folders for path in sorted((self.path / name).glob("*")) if is_picture(path)]

    def read_lab(self) -> LabDocument:
        """Contents of `lab.yaml`; raises InputError where it is refused."""
        return read_yaml(self.path / LAB_FILE).read(LabDocument)

    def read_object(self) -> ObjectDocument:
        """Contents of `object.yaml`; raises InputError where it is refused."""
        return read_yaml(self.path / OBJECT_FILE).read(ObjectDocument)

    def read_station(self) -> Station | None:
        """The station; None where there is none yet."""
        return load_station(self.station) if self.station.is_file() else None

    def read_scene(self, *, found: bool = True) -> dict[str, Any]:
        """Contents of `capture.yaml`, with or without what stages find and write to it; empty where there is none."""
        if not self.scene.is_file():
            return {}
        document = read_yaml(self.scene).value
        if not isinstance(document, dict) or not isinstance(document.get("object", {}), dict):
            raise InputError(self.scene, value="no mapping", allowed="the keys of a capture.yaml")
        if not found:
            document = {**document, "object": {k: v for k, v in document.get("object", {}).items() if k not in FOUND}}
        return document


def write_scene(lab: LabFolder) -> list[str]:
    """Write what is known of object, pusher, table and station to `capture.yaml`; other keys stay.

    Returns:
        Lines of doubt, as `amend` has them.

    Raises:
        InputError: A file is refused, or there is no pusher.
    """
    station, about, before = lab.read_station(), lab.read_object(), lab.read_scene()
    if station is None:
        raise InputError(lab.station, value="no such file", allowed="that of pinwm calibrate")
    pusher = station.document.tool
    if pusher.shape is None and pusher.mesh is None:
        raise InputError(lab.path / LAB_FILE, value="no pusher", allowed="its shape or mesh under tool")
    mesh = None if pusher.mesh is None else str((lab.path / pusher.mesh).resolve())
    shape = None if pusher.shape is None else pusher.shape.model_dump(exclude_none=True)
    about_object = {"name": about.name, "mesh": lab.mesh.relative_to(lab.capture).as_posix(), "mass": about.mass}
    values: dict[tuple[str, ...], Any] = {
        ("schema_version",): SCHEMA_VERSION,
        ("units",): dict(UNITS),
        ("gravity",): _GRAVITY,
        **{("object", key): value for key, value in about_object.items()},
        ("pusher",): {"mesh": mesh, "shape": shape},
        ("floor",): {"height": station.document.world.table.height},
        ("station",): station.sha256,
    }
    values = {keys: value for keys, value in values.items() if keys[0] not in _OF_PERSON or keys[0] not in before}
    prepare_folder(lab.capture)
    return amend(lab.scene, values)
