# SPDX-License-Identifier: MIT
"""Contact sheet of cousins: a picture and the parameters of each."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from matplotlib.axes import Axes

from pinwm_drake.cousins.cousin import Cousins
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.orbit import AZIMUTH, ELEVATION, Orbit, square_camera
from pinwm_drake.report.style import GREY, TRUTH, TWIN, box_around, new_figure, save_figure, show_picture
from pinwm_drake.report.surfels.turntable import to_bytes

_SIZE = 320  # px, of a picture before it is cropped
_WIDTH, _LINE, _HEADING = 1.9, 0.116, 0.3  # inches: of a picture, of a line of text, above a picture
_COLUMNS = 6
_LOUDER = 5.0  # times, of the differences
_MARGIN = 6  # px, around the object
# How a parameter is called, its unit on the sheet, and by what its value is multiplied for that.
_NAMES = {
    "mass": ("m", "kg", 1.0),
    "inertia_xx": ("Ixx", "kg cm²", 1e4),
    "inertia_yy": ("Iyy", "kg cm²", 1e4),
    "inertia_zz": ("Izz", "kg cm²", 1e4),
    "friction_floor": ("μ floor", "", 1.0),
    "friction_pusher": ("μ pusher", "", 1.0),
    "restitution_floor": ("e floor", "", 1.0),
    "restitution_pusher": ("e pusher", "", 1.0),
}


def cousin_figure(path: Path, cousins: Cousins, report: Callable[[float], None] = lambda share: None) -> None:
    """Draws the twin and its cousins from one view, each with its parameters below.

    Below the picture of a cousin is what it has more (brighter) or less (darker) than the twin, five times as strong:
    every surfel is drawn by itself, so that a cousin looks like the twin from afar.

    Args:
        path: File of the figure; the suffix names the format and the folder exists.
        cousins: The cousins; every one is drawn.
        report: Called with the share of the pictures that are drawn.

    Raises:
        InputError: The file cannot be written.
        RenderingError: The twin has no surfels.
    """
    twin, number, ranges = cousins.draw.twin, len(cousins) + 1, cousins.draw.ranges
    keys = [key for key, one in ranges.items() if one.low < one.high] or list(ranges)
    values = {key: estimate.value for key, estimate in twin.theta.items()}
    pictures = _pictures(twin.surfels, [twin.surfels.sh, *(cousin.sh for cousin in cousins.members)], report)
    height, width = pictures[0].shape[:2]
    columns = min(number, _COLUMNS)
    rows = math.ceil(number / columns)
    each = _WIDTH * height / width + len(keys) * _LINE + _HEADING
    figure = new_figure(max(columns * _WIDTH, 5.0), rows * each + 0.65)
    figure.suptitle(_title(cousins), fontsize=9)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    _draw(axes[0], pictures[0], "the twin", [_text(key, values[key], None) for key in keys], TWIN)
    for one, picture, cousin in zip(axes[1:], pictures[1:], cousins.members, strict=False):
        words = [_text(key, cousin.theta[key], values[key]) for key in keys]
        _draw(one, picture, f"cousin {cousin.number}", words, TRUTH)
    for one in axes[number:]:
        one.set_axis_off()
    save_figure(path, figure)


def _title(cousins: Cousins) -> str:
    draw = cousins.draw
    by_interval = [_NAMES[key][0] for key, one in draw.ranges.items() if one.source != "delta"]
    words = f"{draw.twin.name}: {len(cousins)} cousins, ±{100 * draw.delta:g} %, seed {draw.seed}"
    if draw.from_intervals:
        words += f"\nfrom identified intervals: {', '.join(by_interval) or 'none, as the twin has none'}"
    moved = sum(cousin.moved for cousin in cousins.members) / len(cousins)
    return f"{words}\n{100 * moved:.1f} % of the colours kept back to be displayable"


def _pictures(surfels: Surfels, colours: Sequence[torch.Tensor], report: Callable[[float], None]) -> list[torch.Tensor]:
    """Pictures of each set of colours above its difference from the first, all (height, width, 3), cropped alike."""
    camera, X_CO = square_camera(_SIZE), Orbit.around(surfels).pose(AZIMUTH, ELEVATION)
    found: list[torch.Tensor] = []
    window: tuple[slice, slice] | None = None
    for k, sh in enumerate(colours):  # one after another, as all at once need the memory of all
        shown = Surfels(surfels.p_OS, surfels.q_OS, surfels.log_scale, surfels.logit_opacity, sh)
        with torch.no_grad():
            image = render(shown, camera, X_CO, full=False)
        window = window or box_around(image.alpha[0].numpy() > 0.0, 0.0, _MARGIN)
        found.append(image.color[0][window].clamp(0.0, 1.0))
        report((k + 1) / len(colours))
    return [torch.cat([picture, 0.5 + _LOUDER * (picture - found[0])]) for picture in found]


def _text(key: str, value: float, twin: float | None) -> str:
    name, unit, scale = _NAMES[key]
    words = f"{name} {scale * value:.3g}" + (f" {unit}" if unit else "")
    return words if not twin else f"{words} ({100 * (value / twin - 1):+.0f} %)"


def _draw(axes: Axes, picture: torch.Tensor, title: str, lines: Sequence[str], colour: str) -> None:
    show_picture(axes, to_bytes(picture), GREY, linewidth=0.5)
    axes.set_title(title, fontsize=8, color=colour)
    axes.set_xlabel("\n".join(lines), fontsize=6.5, color=TRUTH, linespacing=1.25)
