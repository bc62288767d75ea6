# SPDX-License-Identifier: MIT
"""Posed images of an object at rest, as surfels are fitted to them."""

import glob
from pathlib import Path

import numpy as np
import torch
import trimesh

from pinwm_drake.capture.images import read_image, require_size
from pinwm_drake.capture.paths import is_file, is_folder
from pinwm_drake.capture.transforms import Frame, read_transforms
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.views import View, project
from pinwm_drake.spatial.poses import Pose, compose, identity, inverse

TRANSFORMS = "transforms.json"
PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff", ".gif")


def read_views(path: Path, X_WO: Pose | None = None, *, mesh: trimesh.Trimesh | None = None) -> list[View]:
    """Read the posed images of a nerfstudio folder.

    A folder `masks` beside `transforms.json` holds a mask for each image, see `find_mask`; the key `mask_path` of a
    frame comes first.

    Args:
        path: The folder, or its `transforms.json`.
        X_WO: Pose of the object in the world of the cameras; None where they are the same.
        mesh: The object, metres, frame O: each camera has to be outside it and see it where its image does. None
            leaves this out.

    Returns:
        The views, in the order of the file, with the pose of the object in each camera (OpenCV axes).

    Raises:
        InputError: A file is missing or unreadable, a size does not fit, a pose is not rigid, a camera is
            inside the object, or an image does not show the object where its camera has it.
    """
    frames = read_transforms(path / TRANSFORMS if is_folder(path) else path)
    return [_read_view(frame, X_WO or identity(), mesh) for frame in frames]


def _read_view(frame: Frame, X_WO: Pose, mesh: trimesh.Trimesh | None) -> View:
    X_CO = compose(inverse(frame.X_WC), X_WO)
    if mesh is not None:
        require_outside(frame, X_CO, mesh)
    image, mask = read_frame_image(frame)
    if mesh is not None:
        require_seen(frame, X_CO, mask, mesh)
    return View(frame.file_path, frame.camera, X_CO, torch.from_numpy(image), torch.from_numpy(mask))


def read_frame_image(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Return the image of a frame: (H, W, 3) float32, sRGB in [0, 1], and (H, W) bool, true on the object.

    Raises:
        InputError: Image or mask is missing or unreadable, of another size than the camera's, or shows nothing.
    """
    image, mask = read_image(frame.image_path, frame.mask_path or find_mask(frame.entry.path.parent, frame.image_path))
    require_size(frame.image_path, mask, frame.camera, f"as {frame.entry.path} says ({frame.entry.place})")
    return image, mask


def find_mask(folder: Path, image_path: Path, *, required: bool = True) -> Path | None:
    """Path of the mask of an image; None where `folder` has no folder `masks` with a picture in it.

    Where it is not required, None too where other images have masks and this one has none.

    `masks` mirrors the folders below that of the images: the mask of `images/cam1/a.jpg` is in `masks/cam1`. There it
    is the picture `a.jpg`, or else the only one of `a.png`, `a.jpg.png` and others with these beginnings.

    Raises:
        InputError: There is such a folder, but no mask of the image in it, or more than one may be it.
    """
    masks = folder / "masks"
    if not is_folder(masks):
        return None
    parts = image_path.relative_to(folder).parts if image_path.is_relative_to(folder) else (image_path.name,)
    below = () if ".." in parts else parts[1:-1]
    return named_mask(masks, image_path, Path(*below), folder, required=required)


def named_mask(masks: Path, image_path: Path, below: Path, images: Path, *, required: bool = True) -> Path | None:
    """Path of the mask of an image in a folder of masks, as `find_mask`.

    Args:
        masks: The folder of masks.
        image_path: The image.
        below: Folder of the mask, below `masks`.
        images: The folder from which the image's name in a message counts.
        required: Flag: where other images have masks, this one has to have one.

    Raises:
        InputError: As for `find_mask`.
    """
    name, place = image_path.name, masks / below
    found = [path for path in _pictures(place, image_path.stem) if path.stem in (image_path.stem, name)]
    exact = [path for path in found if path.name == name]
    whole = [path for path in found if path.stem == name]
    if len(exact) == 1 and not whole:
        return exact[0]
    if len(found) > 1:
        raise InputError(
            found[0], value=f"{found[1].name} beside it", allowed=f"one mask of {_short(image_path, images)}"
        )
    if not found:
        if not required or not any(is_picture(path) for path in masks.rglob("*")):
            return None
        allowed = "a mask for each image, or no such folder"
        raise InputError(masks, value=f"no mask {below / image_path.stem}.* of {name}", allowed=allowed)
    twins = [path for path in _pictures(image_path.parent, image_path.stem) if path.stem == image_path.stem]
    others = [path for path in twins if path.name != name]
    if not whole and others:
        allowed = f"masks {name}.png and {others[0].name}.png"
        raise InputError(found[0], value=f"a mask of {name} or of {others[0].name}", allowed=allowed)
    return found[0]


def mask_place(folder: Path, image_path: Path) -> Path:
    """Path at which `find_mask` looks for the mask of an image that has none yet."""
    twins = [path for path in _pictures(image_path.parent, image_path.stem) if path.stem == image_path.stem]
    stem = image_path.stem if len(twins) <= 1 else image_path.name
    parts = image_path.relative_to(folder).parts if image_path.is_relative_to(folder) else (image_path.name,)
    below = () if ".." in parts else parts[1:-1]
    return folder.joinpath("masks", *below, f"{stem}.png")


def is_picture(path: Path) -> bool:
    """Flag: a file is a picture by its name, and not hidden."""
    return path.suffix.lower() in PICTURES and not path.name.startswith(".") and is_file(path)


def _pictures(folder: Path, beginning: str) -> list[Path]:
    return sorted(path for path in folder.glob(f"{glob.escape(beginning)}.*") if is_picture(path))


def _short(path: Path, folder: Path) -> Path:
    return path.relative_to(folder) if path.is_relative_to(folder) else path


def require_outside(frame: Frame, X_CO: Pose, mesh: trimesh.Trimesh) -> None:
    """Require a camera to be outside the object, which has pose X_CO [m] in it; raise InputError otherwise."""
    p_OC = inverse(X_CO).p.numpy()
    if winding_number(mesh, p_OC) > 0.5:
        found = f"a camera inside the object, at {(np.round(p_OC, 4) + 0.0).tolist()} m from its origin"
        raise frame.entry["transform_matrix"].refusal("a camera outside the object", found)


def require_seen(frame: Frame, X_CO: Pose, mask: np.ndarray, mesh: trimesh.Trimesh) -> bool:
    """Return True for a camera that sees the object, with pose X_CO [m] in it, where the mask (H, W) shows it.

    Raises:
        InputError: The camera looks away from it, or the boxes around mesh and mask do not even overlap.
    """
    entry, hint = frame.entry["transform_matrix"], "poses in OpenGL axes that see the object where the image does"
    pixels, depths = (values.numpy() for values in project(frame.camera, X_CO, torch.tensor(np.array(mesh.vertices))))
    if (depths <= 0).all():
        raise entry.refusal(hint, "a camera that looks away from the object")
    if (depths <= 0).any():
        return True
    rows, columns = np.nonzero(mask)
    low, high = np.array([columns.min(), rows.min()]), np.array([columns.max(), rows.max()])
    if (pixels.max(axis=0) < low).any() or (pixels.min(axis=0) > high + 1).any():
        (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
        seen = f"columns {x0:.0f} to {x1:.0f}, rows {y0:.0f} to {y1:.0f}"
        there = f"columns {low[0]} to {high[0]}, rows {low[1]} to {high[1]} of {frame.file_path}"
        raise entry.refusal(hint, f"a camera that sees the mesh at {seen}, while it shows at {there}")
    return True


def winding_number(mesh: trimesh.Trimesh, p_O: np.ndarray) -> float:
    """Winding number of a closed surface [m] around a point p_O (3,) [m] in its frame: 0 outside, 1 or more inside.

    It is whole up to rounding away from the surface, whose faces are turned outwards.

    Source: A. van Oosterom and J. Strackee, "The solid angle of a plane triangle" (1983), eq. 8.
    """
    a, b, c = np.moveaxis(np.asarray(mesh.triangles) - p_O, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", u, v) for u, v in ((a, b), (b, c), (c, a)))
    angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return float(angle.sum() / (4 * np.pi))
