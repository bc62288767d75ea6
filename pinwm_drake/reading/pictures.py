# SPDX-License-Identifier: MIT
"""Pictures whose format and number of pixels are checked before they are decoded."""

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import guarded, read_bytes

_MOST_BYTES, _MOST_PIXELS = 2**28, 30_000_000
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "PPM", "GIF")  # Pillow starts Ghostscript for EPS
_ALLOWED = "a whole image file"


@contextmanager
def opened_picture(path: Path) -> Iterator[Image.Image]:
    """Opens a picture, of which the header alone is read.

    Raises:
        InputError: It is no regular file, no picture or one of another format, has too many pixels, or the block cannot
            decode it.
    """
    content = read_bytes(path, _MOST_BYTES)
    with guarded(path, _ALLOWED), warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        try:
            image = Image.open(io.BytesIO(content), formats=_FORMATS)
        except UnidentifiedImageError as error:
            raise InputError(path, value="contents that are no image", allowed="PNG, JPEG or another image") from error
        except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
            raise InputError(path, value=str(error), allowed=f"{_MOST_PIXELS} pixels at most") from error
        with image:
            if image.width * image.height > _MOST_PIXELS:
                size = f"{image.width} x {image.height} px"
                raise InputError(path, value=size, allowed=f"{_MOST_PIXELS} pixels at most; scale it down")
            yield image
