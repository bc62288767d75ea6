# SPDX-License-Identifier: MIT
"""Lines of text as a picture."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont

from pinwm_drake.report.captions import font

INK, FAINT = "#1f2937", "#4b5563"
_PAPER, _RIM = (255, 255, 255, 240), (140, 146, 156, 255)
_MARGIN, _LEADING = 0.6, 1.4  # in sizes of the letters


def draw_notice(lines: Sequence[tuple[str, str]], *, size: int = 24, width: int = 700, height: int = 0) -> np.ndarray:
    """Picture of lines, the first in bold, on translucent paper with round corners.

    Args:
        lines: Text and colour of each; a long one goes on in the next row.
        size: Of the letters, px.
        width: Of the paper, px.
        height: Of the paper, px, unless the lines need more.

    Returns:
        (height, width, 4) uint8, sRGB.
    """
    margin, rows = round(_MARGIN * size), []
    for number, (text, colour) in enumerate(lines):
        letters = font(size, bold=number == 0)
        rows += [(row, colour, letters) for row in _rows(text, letters, width - 2 * margin)]
    height = max(round(_LEADING * size * len(rows)) + 2 * margin, height)
    picture = Image.new("RGBA", (width, height), (255, 255, 255, 0))
    canvas = ImageDraw.Draw(picture)
    canvas.rounded_rectangle((0, 0, width - 1, height - 1), radius=margin, fill=_PAPER, outline=_RIM)
    for number, (text, colour, letters) in enumerate(rows):
        place = (margin, margin + _LEADING * size * number)
        canvas.text(place, text, font=letters, fill=(*ImageColor.getrgb(colour)[:3], 255))
    return np.asarray(picture)


def _rows(text: str, letters: ImageFont.FreeTypeFont, width: int) -> list[str]:
    """Rows of a text, of whole words, none wider than a number of pixels unless it is one word."""
    rows = [""]
    for word in text.split():
        longer = f"{rows[-1]} {word}".strip()
        if letters.getlength(longer) <= width or not rows[-1]:
            rows[-1] = longer
        else:
            rows.append(word)
    return rows
