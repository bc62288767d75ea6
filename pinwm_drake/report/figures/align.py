"""Figure of a fit of surfels: its history, and the held-out views with their renderings."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pinwm_drake.files import replacing

DIFFERENCE_GAIN = 4
_LOSS, _FITTED, _HELD_OUT = "#8a8f98", "#2f5d9e", "#c8432f"
_MARGIN = 0.08  # of the object's box in the strips


@dataclass(frozen=True, eq=False)
class Strip:
    """Strip of one view, as it is and as it is rendered.

    Attributes:
        name: Name of the view.
        target: (height, width, 3) in [0, 1], sRGB.
        rendered: The same of the surfels.
        psnr: PSNR of the rendering [dB].
    """

    name: str
    target: np.ndarray
    rendered: np.ndarray
    psnr: float


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
    figure = Figure(figsize=(12, max(4.5, 0.6 + 2.1 * len(strips))), dpi=120, layout="constrained")
    figure.suptitle(title, fontsize=11)
    halves = np.asarray(figure.subfigures(1, 2, width_ratios=[1, 1.6]))
    curves, quality = halves[0].subplots(2, 1, sharex=True)
    _draw_loss(curves, loss, window)
    for name, values in psnr:
        held_out = name == "held out"
        marker = "." if held_out or len(values) == 1 else ""
        quality.plot(
            *values.T, color=_HELD_OUT if held_out else _FITTED, marker=marker, zorder=2 + held_out, label=name
        )
    quality.set_ylabel("PSNR [dB]")
    quality.set_xlabel("iteration")
    quality.legend(frameon=False, fontsize=8)
    for axes in (curves, quality):
        axes.grid(color="#e3e5e8")
        axes.spines[["top", "right"]].set_visible(False)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    pictures = halves[1].subplots(len(strips), 3, squeeze=False)
    for row, strip in zip(pictures, strips, strict=True):
        _draw_strip(row, strip)
    for axes, name in zip(pictures[0], ("target", "rendered", f"difference × {DIFFERENCE_GAIN}"), strict=True):
        axes.set_title(name, fontsize=9)
    with replacing(path) as temporary:
        figure.savefig(temporary)


def _draw_loss(axes: Axes, loss: np.ndarray, window: int) -> None:
    """Draws the loss of each iteration, faint, and its running mean; the axis is logarithmic."""
    axes.plot(*loss.T, color=_LOSS, linewidth=0.5, alpha=0.5)
    if len(loss) >= window:
        smooth = np.convolve(loss[:, 1], np.full(window, 1 / window), mode="valid")
        axes.plot(loss[window - 1 :, 0], smooth, color=_LOSS, linewidth=1.5)
    if (loss[:, 1] > 0).all():
        axes.set_yscale("log")
    axes.set_ylabel("loss")


def _draw_strip(row: np.ndarray, strip: Strip) -> None:
    """Draws target, rendering and difference of one view, cut to the part that shows something."""
    difference = np.clip(DIFFERENCE_GAIN * np.abs(strip.rendered - strip.target), 0, 1)
    window = _window(np.minimum(strip.target, strip.rendered).min(axis=-1) < 1)
    for axes, picture in zip(row, (strip.target, strip.rendered, difference), strict=True):
        axes.imshow(np.clip(picture[window], 0, 1), interpolation="nearest")
        axes.set_xticks([])
        axes.set_yticks([])
        axes.spines[:].set_color("#c9ccd1")
    row[0].set_ylabel(f"{strip.name}\n{strip.psnr:.1f} dB", fontsize=8)


def _window(shown: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of the box around the pixels that are true, with a margin."""
    slices = []
    for axis in (1, 0):
        places = np.flatnonzero(shown.any(axis=axis))
        first, last = (places[0], places[-1]) if len(places) else (0, shown.shape[1 - axis] - 1)
        margin = int(_MARGIN * (last - first + 1)) + 1
        slices.append(slice(max(first - margin, 0), last + 1 + margin))
    return slices[0], slices[1]
