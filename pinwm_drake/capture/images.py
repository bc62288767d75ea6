# SPDX-License-Identifier: MIT
"""Images of an object: colour on white, and the mask of the pixels that show it."""

from pathlib import Path

import numpy as np

from pinwm_drake.capture.background import ALPHA, cut_out, on_white
from pinwm_drake.capture.paths import require_file
from pinwm_drake.errors import InputError
from pinwm_drake.reading.pictures import opened_picture
from pinwm_drake.rendering.camera import Camera

_MODES = ("1", "L", "RGB", "P", "RGBA", "LA", "PA")  # 8 bits a channel, or less


def read_image(
    path: Path, mask_path: Path | None = None, *, may_be_empty: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Read a picture of an object.

    The object is where the mask is white; without a mask, where alpha is 128 and above; without alpha, where the
    picture is not white. See `background`.

    Args:
        path: Grey or colour, 8 bits a channel, with or without alpha.
        mask_path: A grey picture of the same size, 128 and above on the object; None for none.
        may_be_empty: Whether the picture may show nothing of the object.

    Returns:
        (height, width, 3) float32, sRGB in [0, 1], white where the object is not; and (height, width) bool,
        true on the object.

    Raises:
        InputError: A file is missing, truncated or of another kind, the mask has another size, no pixel shows
            the object, or nothing tells the object from its background for sure.
    """
    pixels = read_pixels(path)
    if mask_path is not None:
        mask = read_mask(mask_path)
        if mask.shape != pixels.shape[:2]:
            raise InputError(mask_path, value=size_of(mask), allowed=f"{size_of(pixels)}, the size of {path}")
        alpha = mask.astype(np.float32)
    else:
        opaque = pixels[..., 3].min() == 255
        mask = on_white(path, pixels[..., :3]) if opaque else cut_out(path, pixels[..., 3])
        alpha = pixels[..., 3].astype(np.float32) / np.float32(255)
    if not mask.any() and not may_be_empty:
        raise InputError(mask_path or path, value="no pixel of the object", allowed="an image that shows the object")
    image = np.ones((*mask.shape, 3), np.float32)
    share = alpha[mask][:, None]
    image[mask] = np.clip(pixels[mask, :3] / np.float32(255) * share + (1 - share), 0, 1)
    return image, mask


def read_photo(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Return a photo (H, W, 3) uint8, sRGB, and the mask (H, W) bool of its alpha; None where it is opaque.

    Raises:
        InputError: It is missing, truncated or of another kind, or alpha does not tell object from background.
    """
    pixels = read_pixels(path)
    opaque = pixels[..., 3].min() == 255
    return np.ascontiguousarray(pixels[..., :3]), None if opaque else cut_out(path, pixels[..., 3])


def read_size(path: Path) -> tuple[int, int]:
    """Width and height of an image, px.

    Raises:
        InputError: It is missing, truncated or of another kind.
    """
    pixels = _read(path, "L")
    return pixels.shape[1], pixels.shape[0]


def read_pixels(path: Path) -> np.ndarray:
    """Pixels (height, width, 4) uint8 of a picture, sRGB and alpha; errors as for `read_image`."""
    return _read(path, "RGBA")


def read_mask(path: Path) -> np.ndarray:
    """Return a mask (H, W) bool, true where it is 128 and above; raises InputError as `read_image`."""
    grey = _read(path, "L")
    if 0 < grey.max() < ALPHA:
        allowed = f"0, and {ALPHA} to 255 on the object"
        raise InputError(path, value=f"a mask whose largest value is {grey.max()}", allowed=allowed)
    return grey >= ALPHA


def _read(path: Path, mode: str) -> np.ndarray:
    """Return the pixels of a file converted to a mode: (height, width) or (height, width, channels) uint8."""
    require_file(path, "an image file")
    with opened_picture(path) as image:
        if image.mode not in _MODES:
            raise InputError(path, value=f"mode {image.mode}", allowed="8 bits a channel, grey or RGB")
        return np.asarray(image.convert(mode))


def size_of(image: np.ndarray) -> str:
    """Width and height of an image (H, W, ...), in words."""
    return f"{image.shape[1]} x {image.shape[0]} px"


def require_size(path: Path, mask: np.ndarray, camera: Camera, why: str) -> None:
    """Require an image, by its mask (H, W), to have the size of its camera; raise InputError that says why."""
    if mask.shape != (camera.height, camera.width):
        raise InputError(path, value=size_of(mask), allowed=f"{camera.width} x {camera.height} px, {why}")
