"""The capture that an importer writes: its scene, and files copied into it."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from pinwm_drake.capture.paths import require_file
from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.capture.write import write_capture_yaml
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.spatial.poses import Pose


@dataclass(frozen=True, eq=False)
class Scenery:
    """Parts of a scene that the images of others do not have.

    Attributes:
        name: Name of the object.
        mesh: The object's mesh, m, O.
        X_WO: Pose of the object in the world of the capture; None where the imported data have it, or for the
            identity.
        mass: Mass of the object, kg; None where it was not measured.
        pusher_mesh: The pusher's mesh, m, P; or None.
        pusher_shape: The pusher's shape; or None.
        floor_height: Height of the floor, m.
        gravity: m/s^2, downwards.
    """

    name: str
    mesh: Path
    X_WO: Pose | None = None
    mass: float | None = None
    pusher_mesh: Path | None = None
    pusher_shape: PusherShape | None = None
    floor_height: float = 0.0
    gravity: float = 9.8


def write_scenery(folder: Path, scenery: Scenery, X_WO: Pose) -> None:
    """Writes `capture.yaml`, and copies the meshes.

    Args:
        folder: The capture.
        scenery: The scene to write.
        X_WO: The object's pose; q (4,), p (3,) [m].

    Raises:
        InputError: A mesh is refused, or a file cannot be written.
    """
    meshes: dict[str, str | None] = {"object": None, "pusher": None}
    for role, path in (("object", scenery.mesh), ("pusher", scenery.pusher_mesh)):
        if path is not None:
            load_mesh(path)
            meshes[role] = f"meshes/{role}{path.suffix.lower()}"
            copy_file(path, folder / str(meshes[role]))
    write_capture_yaml(
        folder,
        name=scenery.name,
        mesh=str(meshes["object"]),
        mass=scenery.mass,
        X_WO=X_WO,
        pusher_mesh=meshes["pusher"],
        pusher_shape=scenery.pusher_shape,
        floor_height=scenery.floor_height,
        gravity=scenery.gravity,
    )


def copy_file(source: Path, target: Path) -> None:
    """Copies a file; makes the folder of `target` if need be.

    Raises:
        InputError: The file cannot be read, or its copy not written.
    """
    require_file(source, "a file to copy")
    prepare_folder(target.parent)
    with replacing(target) as temporary:
        shutil.copyfile(source, temporary)
