# SPDX-License-Identifier: MIT
"""Pages from Jinja2 templates: every text is escaped, and pictures and figures are data URIs."""

import base64
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

from pinwm_drake.files import replacing
from pinwm_drake.twin.twin import Estimate
from pinwm_drake.twin.words import estimate_words, handy

Frame = tuple[float, np.ndarray, str]  # time [s], picture (height, width, 3) uint8 sRGB, caption
_QUALITY = 88  # of JPEG


def write_page(path: Path, template: str, **contents: Any) -> None:
    """Write a page that loads nothing from anywhere, from a template in the package and its variables.

    Raises:
        InputError: The file cannot be written.
    """
    # A lone surrogate, as a path of bytes that are no UTF-8 has it, cannot be encoded.
    text = templates.get_template(template).render(contents).encode("utf-8", "replace")
    with replacing(path) as temporary:
        temporary.write_bytes(text)


def data_uri(shown: Figure | np.ndarray) -> str:
    """Return a figure as SVG, or a picture (height, width, 3) uint8, sRGB, as JPEG: reproducible bytes."""
    buffer = io.BytesIO()
    if isinstance(shown, Figure):
        kind = "svg+xml"
        with rc_context({"svg.hashsalt": "pinwm", "svg.fonttype": "path"}):
            shown.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    else:
        kind = "jpeg"
        Image.fromarray(shown).save(buffer, format="JPEG", quality=_QUALITY, subsampling=0, optimize=True)
    return f"data:image/{kind};base64,{base64.b64encode(buffer.getvalue()).decode()}"


def _frames(pictures: Iterable[Frame]) -> list[dict[str, Any]]:
    return [{"t": round(t, 6), "src": data_uri(picture), "words": words} for t, picture, words in pictures]


def interval_words(estimate: Estimate) -> tuple[str, str]:
    """Value and interval in words, both to the digits that the interval leaves."""
    words = estimate_words(estimate)
    return words.value, words.interval or "–"


def error_words(estimate: Estimate, truth: float | None) -> tuple[str, str]:
    """Return the true value in the unit that is shown, and the error of an estimate in per cent of it."""
    if truth is None:
        return "–", "–"
    factor, _ = handy(estimate.unit)
    error = f"{100 * (estimate.value - truth) / abs(truth):+.1f} %" if truth else f"{factor * estimate.value:+.3g}"
    return f"{factor * truth:.4g}", error


templates = Environment(
    loader=FileSystemLoader(Path(__file__).parents[1]),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
templates.filters |= {"uri": data_uri, "frames": _frames, "interval": interval_words, "error": error_words}
templates.filters["unit"] = lambda unit: handy(unit)[1]
templates.tests["list"] = lambda value: isinstance(value, list)
