# SPDX-License-Identifier: MIT
"""Pages from Jinja2 templates: every text is escaped, and pictures and figures are data URIs."""

import base64
import io
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

from pinwm_drake.files import replacing
from pinwm_drake.twin.twin import Estimate

Frame = tuple[float, np.ndarray, str]  # time [s], picture (height, width, 3) uint8 sRGB, caption
_NOTHING = 1e-6  # width of an interval that says nothing, as a share of the value
_QUALITY = 88  # of JPEG
_READABLE = {"m": ("mm", 1e3), "rad": ("°", 180 / math.pi), "s": ("ms", 1e3)}


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


def readable(estimate: Estimate) -> Estimate:
    """Return an estimate of a length, an angle or a time in mm, degrees or ms; others as they are."""
    unit, scale = _READABLE.get(estimate.unit, (estimate.unit, 1.0))
    interval = estimate.interval and (scale * estimate.interval[0], scale * estimate.interval[1])
    return replace(estimate, value=scale * estimate.value, interval=interval, unit=unit)


def interval_words(estimate: Estimate) -> tuple[str, str]:
    """Value and interval in words, to the digits that the interval leaves; a dash for none or one without width."""
    low, high = estimate.interval or (estimate.value, estimate.value)
    if high - low <= _NOTHING * abs(estimate.value):
        return f"{estimate.value:.4g}", "–"
    digits = 4
    if 0.0 < high - low < math.inf and estimate.value != 0.0:
        digits = min(max(1 + math.ceil(math.log10(abs(estimate.value) / (high - low))), 3), 8)
    return _rounded(estimate.value, digits), f"{_rounded(low, digits)} to {_rounded(high, digits)}"


def _rounded(value: float, digits: int) -> str:
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:#.{digits}g}".rstrip(".") if value else "0"


def error_words(estimate: Estimate, truth: float | None) -> tuple[str, str]:
    """Return the true value, and the error of an estimate in per cent of it."""
    if truth is None:
        return "–", "–"
    error = f"{100 * (estimate.value - truth) / abs(truth):+.1f} %" if truth else f"{estimate.value - truth:+.3g}"
    return f"{truth:.4g}", error


templates = Environment(
    loader=FileSystemLoader(Path(__file__).parents[1]),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
templates.filters |= {
    "uri": data_uri,
    "frames": _frames,
    "interval": interval_words,
    "error": error_words,
    "readable": readable,
}
templates.tests["list"] = lambda value: isinstance(value, list)
