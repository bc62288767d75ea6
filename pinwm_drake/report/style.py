"""Style of the figures of a twin's report."""

from collections.abc import Iterable

from matplotlib.axes import Axes
from matplotlib.figure import Figure

TWIN, TRUTH, PUSHER, GREY, GRID = "#c8432f", "#1f2937", "#2f5d9e", "#8a8f98", "#e3e5e8"
STARTS = ("#2f5d9e", "#c8432f", "#3b8f5a", "#b07d1a", "#7a4fa3", "#3a9aa8", "#a1505f", "#6b7280")


def new_figure(width: float, height: float) -> Figure:
    """An empty figure; inches, of which a page shows 96 px each."""
    return Figure(figsize=(width, height), dpi=96, layout="constrained")


def tidy(axes: Iterable[Axes]) -> None:
    """Style of axes: grid behind, no frame on top and on the right."""
    for one in axes:
        one.grid(color=GRID)
        one.set_axisbelow(True)
        one.spines[["top", "right"]].set_visible(False)


def start_colour(number: int) -> str:
    """The colour of a random start."""
    return STARTS[number % len(STARTS)]
