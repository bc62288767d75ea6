# SPDX-License-Identifier: MIT
"""Posed images of an object at rest, as surfels are fitted to them."""

import glob
from pathlib import Path

import numpy as np
import torch
import trimesh

from pinwm_drake.capture.images import read_image, require_size
from pinwm_drake.capture.paths import is_folder
from pinwm_drake.capture.transforms import Frame, read_transforms
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.views import View, project
from pinwm_drake.spatial.poses import Pose, compose, identity, inverse

TRANSFORMS = "transforms.json"


def read_views(path: Path, X_WO: Pose | None = None, *, mesh: trimesh.Trimesh | None = None) -> list[View]:
    """Read the posed images of a nerfstudio folder.

    A folder `masks` beside `transforms.json` holds a mask for each image, with its name up to the suffix; the key
    `mask_path` of a frame comes first.

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


def find_mask(folder: Path, image_path: Path) -> Path | None:
    """Path of the mask of an image, with its name up to the suffix; None where `folder` has no folder `masks`.

    Raises:
        InputError: There is such a folder, but the mask is not in it.
    """
    masks = folder / "masks"
    if not is_folder(masks):
        return None
    found = sorted(masks.glob(f"{glob.escape(image_path.stem)}.*"))
    if not found:
        allowed = "a mask for each image, or no such folder"
        raise InputError(masks, value=f"no mask {image_path.stem}.*", allowed=allowed)
    return found[0]


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
