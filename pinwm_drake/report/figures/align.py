# SPDX-License-Identifier: MIT
"""Figure of a fit of surfels: its history, and the held-out views with their renderings."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.ticker import MaxNLocator

from pinwm_drake.report.style import (
    GREY,
    GRID,
    PUSHER,
    TWIN,
    box_around,
    new_figure,
    plain_log,
    save_figure,
    show_picture,
)

DIFFERENCE_GAIN = 4
_MARGIN = 0.08  # of the object's box in the strips


@dataclass(frozen=True, eq=False)
class Strip:
    """Strip of one view, as it is and as it is rendered: pictures (height, width, 3) in [0, 1], sRGB."""

    name: str
    target: np.ndarray
    rendered: np.ndarray
    psnr: float  # dB, of the rendering


def align_figure(
    path: Path,
    *,
    loss: np.ndarray,
    window: int,
    psnr: Sequence[tuple[str, np.ndarray]],
    strips: Sequence[Strip],
    title: str,
) -> None:
    """Draws loss and PSNR over the iterations, and target, rendering and difference of some views.

    Args:
        path: File of the figure; the suffix names the format and the folder exists.
        loss: (n, 2): iteration and loss.
        window: Over how many iterations the loss is averaged, 1 or more: those that see every view once.
        psnr: Curves: "fitted" or "held out", and (m, 2) of iteration and mean PSNR [dB].
        strips: Strips, one or more, each a row of pictures.
        title: Stands above the figure.

    Raises:
        InputError: The file cannot be written.
    """
    figure = new_figure(12, max(4.5, 0.6 + 2.1 * len(strips)), dpi=120)
    figure.suptitle(title, fontsize=11)
    left, right = np.asarray(figure.subfigures(1, 2, width_ratios=[1, 1.6]))
    curve, quality = left.subplots(2, 1, sharex=True)
    curve.plot(*loss.T, color=GREY, linewidth=0.5, alpha=0.5)
    if len(loss) >= window:
        smooth = np.convolve(loss[:, 1], np.full(window, 1 / window), mode="valid")
        curve.plot(loss[window - 1 :, 0], smooth, color=GREY, linewidth=1.5)
    curve.set(ylabel="loss")
    if (loss[:, 1] > 0).all():
        plain_log(curve)
    for name, values in psnr:
        held_out = name == "held out"
        marker, colour = "." if held_out or len(values) == 1 else "", TWIN if held_out else PUSHER
        quality.plot(*values.T, color=colour, marker=marker, zorder=2 + held_out, label=name)
    quality.set(xlabel="iteration", ylabel="PSNR [dB]")
    quality.legend(frameon=False, fontsize=8)
    for axes in (curve, quality):
        axes.grid(color=GRID)
        axes.spines[["top", "right"]].set_visible(False)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    pictures = right.subplots(len(strips), 3, squeeze=False)
    for row, strip in zip(pictures, strips, strict=True):
        difference = DIFFERENCE_GAIN * np.abs(strip.rendered - strip.target)
        box = box_around(np.minimum(strip.target, strip.rendered).min(axis=-1) < 1, _MARGIN, 1)
        for axes, picture in zip(row, (strip.target, strip.rendered, difference), strict=True):
            show_picture(axes, np.clip(picture[box], 0, 1), "#c9ccd1", interpolation="nearest")
        row[0].set_ylabel(f"{strip.name}\n{strip.psnr:.1f} dB", fontsize=8)
    for axes, name in zip(pictures[0], ("target", "rendered", f"difference × {DIFFERENCE_GAIN}"), strict=True):
        axes.set_title(name, fontsize=9)
    save_figure(path, figure)
