# SPDX-License-Identifier: MIT
"""The capture that an importer writes: its scene, its static views, and files copied into it."""

import os
import shutil
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pinwm_drake.capture.images import read_image, require_size
from pinwm_drake.capture.importers.lenses import write_undistorted
from pinwm_drake.capture.importers.similarity import Similarity
from pinwm_drake.capture.lens import Lens
from pinwm_drake.capture.paths import is_folder, require_file
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import CAPTURE_FILE, FARTHEST, PusherGeometry, PusherShape
from pinwm_drake.capture.static_views import is_picture
from pinwm_drake.capture.units import EXTENT, PUSHER_EXTENT, Seen, scale_doubts, scene_doubts, seen_size, size_doubts
from pinwm_drake.capture.write import write_capture_yaml, write_posed_images
from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose


@dataclass(frozen=True, eq=False)
class Scenery:
    """Parts of a scene that the images of others do not have."""

    name: str
    mesh: Path  # m, O
    X_WO: Pose | None = None  # in the world of the capture; None where the imported data have it, or for the identity
    mass: float | None = None  # kg; None where it was not measured
    pusher_mesh: Path | None = None  # m, P
    pusher_shape: PusherShape | None = None
    floor_height: float = 0.0  # m
    gravity: float = 9.8  # m/s^2, downwards


@dataclass(frozen=True, eq=False)
class PosedImage:
    """Posed image of others, with its camera and maybe a mask."""

    path: Path
    mask_path: Path | None
    camera: Camera
    X_SC: Pose  # of the camera in the world S of the source, OpenCV axes; q (4,), p (3,) in the unit of S
    lens: Lens | None = None  # that took it, where it has distortion


def write_scenery(folder: Path, scenery: Scenery, X_WO: Pose) -> None:
    """Write the `capture.yaml` of a folder, with the object at X_WO: q (4,), p (3,) [m]; and copy the meshes.

    Raises:
        InputError: A mesh is refused, or a file cannot be written.
    """
    meshes: dict[str, str] = {}
    for role, path in (("object", scenery.mesh), ("pusher", scenery.pusher_mesh)):
        if path is not None:
            tell(size_doubts(path, load_mesh(path), EXTENT if role == "object" else PUSHER_EXTENT))
            meshes[role] = f"meshes/{role}{path.suffix.lower()}"
            copy_file(path, folder / meshes[role])
    tell(
        scene_doubts(
            folder / CAPTURE_FILE,
            mesh=load_mesh(scenery.mesh),
            X_WO=X_WO,
            floor_height=scenery.floor_height,
            gravity=scenery.gravity,
            mass=scenery.mass,
        )
    )
    if scenery.pusher_shape is not None:
        shape = pusher_surface(PusherGeometry(None, scenery.pusher_shape))
        tell(size_doubts(folder / CAPTURE_FILE, shape, PUSHER_EXTENT))
    own = {"mesh": meshes["object"], "X_WO": X_WO, "pusher_mesh": meshes.get("pusher")}
    write_capture_yaml(folder, **vars(scenery) | own)


def copy_file(source: Path, target: Path) -> None:
    """Copy a file, and make the folder of `target` if need be; raise InputError where that fails."""
    require_file(source, "a file to copy")
    prepare_folder(target.parent)
    with replacing(target) as temporary:
        shutil.copyfile(source, temporary)


Report = Callable[[float], None]
"""Called with the share of an import that is done, 0 to 1."""


def unheard(share: float) -> None:
    """Report to nobody."""


def tell(doubts: list[InputError]) -> None:
    """Warns of each doubt about a unit."""
    for doubt in doubts:
        warnings.warn(str(doubt), UserWarning, stacklevel=2)


def tell_unposed(folder: Path, images: list[Path]) -> None:
    """Warns of pictures beside the posed ones, in the folders of these, that have no pose and are left out.

    Args:
        folder: Folder from which the names in the warning count.
        images: The posed pictures.
    """
    posed = {path.resolve() for path in images}
    near = (
        other for place in sorted({path.parent for path in images}) if is_folder(place) for other in place.iterdir()
    )
    left = sorted(os.path.relpath(path, folder) for path in near if is_picture(path) and path.resolve() not in posed)
    if left and {Path(name).parent for name in left} != {Path()}:
        more = f" and {len(left) - 1} more" if len(left) > 1 else ""
        warnings.warn(f"{folder}: {left[0]}{more} without a pose, left out", UserWarning, stacklevel=2)


def write_static(
    folder: Path,
    images: list[PosedImage],
    similarity: Similarity,
    mesh: Path,
    X_WO: Pose,
    report: Report = unheard,
) -> None:
    """Copy images and masks to `static/` of a capture and write its `transforms.json`; warn of poses in another unit.

    Images of a lens with distortion are written as a pinhole at their place would show them.

    Args:
        folder: The capture.
        images: The images.
        similarity: Similarity from their world to that of the capture.
        mesh: File of the object's mesh, m, O.
        X_WO: Pose of the object in the capture's world; q (4,), p (3,) [m].
        report: Called after each image with the share of them that is done.

    Raises:
        InputError: An image is refused or of another size than its camera's, some have a mask and some not, a camera
            is a kilometre away, or a file cannot be written.
    """
    frames: list[tuple[str, Camera, Pose]] = []
    seen: list[Seen] = []
    masked = [image for image in images if image.mask_path is not None]
    for k, image in enumerate(images):
        if masked and image.mask_path is None:
            raise InputError(image.path, value="no mask", allowed="a mask for each image, or none at all")
        mask = read_image(image.path, image.mask_path)[1]
        require_size(image.path, mask, image.camera, "as its camera has")
        X_WC = similarity.pose(image.X_SC)
        if float(X_WC.p.abs().max()) > FARTHEST:
            found, allowed = f"a camera at {X_WC.p.tolist()} m", f"within {FARTHEST:g} m; see --scale, m for a unit"
            raise InputError(image.path, value=found, allowed=allowed)
        camera, name = image.camera, f"images/{k:05}{image.path.suffix.lower() if image.lens is None else '.png'}"
        if image.lens is not None:
            mask_target = None if image.mask_path is None else folder / f"static/masks/{k:05}.png"
            camera, mask = write_undistorted(image.path, image.lens, mask, folder / "static" / name, mask_target)
        else:
            copy_file(image.path, folder / "static" / name)
            if image.mask_path is not None:
                copy_file(image.mask_path, folder / f"static/masks/{k:05}{image.mask_path.suffix.lower()}")
        seen.append(Seen(camera, X_WC, seen_size(mask)))
        frames.append((name, camera, X_WC))
        report((k + 1) / len(images))
    tell(scale_doubts(folder / "static/transforms.json", seen, load_mesh(mesh), X_WO))
    write_posed_images(folder / "static/transforms.json", frames)
