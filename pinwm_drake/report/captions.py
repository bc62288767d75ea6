# SPDX-License-Identifier: MIT
"""Captions written on pictures."""

from functools import cache

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont


@cache
def font(size: int, *, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Return letters of a size [px]; Matplotlib ships them, so that they are there on every machine."""
    properties = font_manager.FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")
    return ImageFont.truetype(font_manager.findfont(properties), size)


def write_caption(image: np.ndarray, *texts: str) -> np.ndarray:
    """Write one line into the lower left corner of a picture, or of each of several panels side by side.

    Args:
        image: (height, width, 3) uint8, sRGB, changed in place; its width is a multiple of the number of panels.
        texts: The caption of each panel.
    """
    height, size = image.shape[0], max(8, image.shape[0] // 27)
    for panel, text in zip(np.split(image, len(texts), axis=1), texts, strict=True):
        canvas = Image.fromarray(panel)
        ImageDraw.Draw(canvas).text((size, height - 2 * size), text, font=font(size), fill=(45, 52, 64))
        panel[:] = np.asarray(canvas)
    return image
