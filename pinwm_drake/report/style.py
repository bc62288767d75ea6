# SPDX-License-Identifier: MIT
"""Style of the figures, and what several of them draw."""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from pinwm_drake.files import replacing

TWIN, TRUTH, PUSHER, GREY, GRID = "#c8432f", "#1f2937", "#2f5d9e", "#8a8f98", "#e3e5e8"
_STEPS, _WIDE = (1.0, 2.0, 5.0), 100.0  # of a decade, with a number each, and range from which on decades have one
BELOW_LABEL = 4.5  # of a legend below axes, in sizes of its letters, that leaves room for ticks and label
STARTS = ("#2f5d9e", "#c8432f", "#3b8f5a", "#b07d1a", "#7a4fa3", "#3a9aa8", "#a1505f", "#6b7280")


def new_figure(width: float, height: float, dpi: int = 96) -> Figure:
    """Return an empty figure; inches, of which a page shows 96 px each."""
    return Figure(figsize=(width, height), dpi=dpi, layout="constrained")


def save_figure(path: Path, figure: Figure) -> None:
    """Write a figure whole or not at all; the suffix names the format. Raises InputError where it cannot."""
    with replacing(path) as temporary:
        figure.savefig(temporary)


def tidy(axes: Iterable[Axes]) -> None:
    """Style of axes: grid behind, no frame on top and on the right, plain numbers beside a logarithmic scale."""
    for one in axes:
        if one.get_yscale() == "log":
            low, high = one.get_ylim()
            one.yaxis.set_major_locator(LogLocator(subs=_STEPS if high < _WIDE * low else (1.0,)))
            one.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            one.yaxis.set_minor_formatter(NullFormatter())
        one.grid(color=GRID)
        one.set_axisbelow(True)
        one.spines[["top", "right"]].set_visible(False)


def plain_log(axes: Axes) -> None:
    """Make the y axis logarithmic, with numbers such as 0.02 and 6 in place of powers of ten."""
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    axes.yaxis.set_minor_formatter(lambda value, _: f"{value:g}")


def label_plane(axes: Axes) -> None:
    """Labels and limits of axes that show the world from above, in millimetres."""
    axes.margins(0.05)
    axes.autoscale_view()
    axes.set(xlabel="x [mm]", ylabel="y [mm]")


def show_picture(
    axes: Axes, picture: np.ndarray, frame: str, *, linewidth: float = 0.8, interpolation: str = "auto"
) -> None:
    """Show a picture (height, width, 3) without ticks, in a frame of one colour."""
    axes.imshow(picture, interpolation=interpolation)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(color=frame, linewidth=linewidth)


def start_colour(number: int) -> str:
    """Return the colour of a random start."""
    return STARTS[number % len(STARTS)]


def evenly(number: int, most: int) -> list[int]:
    """Return at most `most` of the numbers 0 to `number - 1` at equal distances, the ends among them."""
    return [int(k) for k in np.unique(np.linspace(0, number - 1, min(most, number)).round())]


def box_around(shown: np.ndarray, share: float, pixels: int) -> tuple[slice, slice]:
    """Rows and columns of the box around the true pixels of a mask (height, width), or of all.

    Its margin is a share of the box, and some pixels more.
    """
    x, y, width, height = cv2.boundingRect(shown.astype(np.uint8))
    if not width:
        height, width = shown.shape
    above, aside = int(share * height) + pixels, int(share * width) + pixels
    return slice(max(y - above, 0), y + height + above), slice(max(x - aside, 0), x + width + aside)
