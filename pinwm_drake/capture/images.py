"""Images of an object: colour on white, and which pixels show it."""

import warnings
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from pinwm_drake.errors import InputError

_GREY, _COLOUR, _WITH_ALPHA = ("1", "L"), ("RGB", "P"), ("RGBA", "LA", "PA")


def read_image(path: Path, mask_path: Path | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Reads a picture of an object.

    The object is where the mask is white; without a mask, where alpha is above 0; without alpha, wherever the
    picture is not white (255, 255, 255).

    Args:
        path: Grey or colour, 8 bits a channel, with or without alpha.
        mask_path: A grey picture of the same size, 128 and above on the object; None for none.

    Returns:
        (height, width, 3) float32, sRGB in [0, 1], white where the object is not; and (height, width) bool,
        true on the object.

    Raises:
        InputError: A file is missing, truncated or of another kind, the mask has another size, no pixel shows
            the object, or nothing tells the object from its background.
    """
    pixels = _read(path, (*_GREY, *_COLOUR, *_WITH_ALPHA), "RGBA")
    image = pixels[..., :3].astype(np.float32) / np.float32(255)
    alpha = pixels[..., 3:].astype(np.float32) / np.float32(255)
    if mask_path is not None:
        mask = _read(mask_path, (*_GREY, *_COLOUR, *_WITH_ALPHA), "L") >= 128
        if mask.shape != image.shape[:2]:
            raise InputError(mask_path, value=_size(mask), allowed=f"{_size(image)}, the size of {path}")
        alpha = mask[..., None].astype(np.float32)
    else:
        mask = alpha[..., 0] > 0 if alpha.min() < 1 else pixels[..., :3].min(axis=-1) < 255
        if alpha.min() == 1 and mask.all():
            raise InputError(
                path, value="no white pixel", allowed="a white background, an alpha channel, or a mask in masks/"
            )
    if not mask.any():
        raise InputError(mask_path or path, value="no pixel of the object", allowed="an image that shows the object")
    return np.clip(image * alpha + (1 - alpha), 0, 1), mask


def _read(path: Path, modes: tuple[str, ...], mode: str) -> np.ndarray:
    """The pixels of a file converted to a mode: (height, width) or (height, width, channels) uint8."""
    if not path.is_file():
        raise InputError(path, value="no such file", allowed="an image file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path) as image:
                if image.mode not in modes:
                    raise InputError(path, value=f"mode {image.mode}", allowed="8 bits a channel, grey or RGB")
                return np.asarray(image.convert(mode))
    except UnidentifiedImageError as error:
        raise InputError(path, value="contents that are no image", allowed="PNG, JPEG or another image") from error
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise InputError(path, value=str(error), allowed=f"at most {Image.MAX_IMAGE_PIXELS} pixels") from error
    except InputError:
        raise
    except Exception as error:  # the decoders raise OSError, SyntaxError, ValueError, struct.error, EOFError ...
        raise InputError(path, value=f"unreadable contents ({error})", allowed="a whole image file") from error


def _size(image: np.ndarray) -> str:
    return f"{image.shape[1]} x {image.shape[0]} px"
