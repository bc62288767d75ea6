"""Film of the identified episode on a page: a player that needs no codec, and strips of a few frames."""

import json
from collections.abc import Sequence

import numpy as np

from pinwm_drake.report.embed import picture_uri
from pinwm_drake.report.page import text
from pinwm_drake.report.twin.comparison_frames import PANELS, Shot
from pinwm_drake.report.twin.score import PoseErrors

_STRIPS = 6
_COMFORTABLE = 4.0  # s that a film had better last
_SPEEDS = (1.0, 0.5, 0.25, 0.125)


def player(shots: list[Shot], errors: PoseErrors | None) -> str:
    """Player of a film of all frames, with the names of its panels, as HTML."""
    names = "".join(f"<span>{name}</span>" for name in PANELS)
    return film_player([(shot.t, shot.joined(), _words(shot, errors)) for shot in shots], names)


def film_player(pictures: Sequence[tuple[float, np.ndarray, str]], names: str = "") -> str:
    """Player of a film, drawn by a few lines of script and played again and again, as HTML.

    Args:
        pictures: Time [s], picture (height, width, 3) uint8 sRGB, and caption of each frame; one or more.
        names: HTML above it.
    """
    frames = [{"t": round(t, 6), "src": picture_uri(picture), "words": words} for t, picture, words in pictures]
    # A "<" could end the script.
    data = json.dumps(frames).replace("<", "\\u003c")
    return f"""<div class="player">
<div class="names">{names}</div>
<img src="{frames[0]["src"]}" alt="{text(frames[0]["words"])}">
<div class="controls" hidden><button type="button">Play</button>
<input type="range" min="0" max="{len(frames) - 1}" value="0" aria-label="frame">
<select aria-label="speed">{_speeds(pictures[-1][0] - pictures[0][0])}</select></div>
<p class="caption">{text(frames[0]["words"])}</p>
<script type="application/json">{data}</script>
</div>"""


def strips(shots: list[Shot]) -> str:
    """Strips of camera, twin and difference, one below the other, for a few frames at equal distances, as HTML."""
    chosen = np.unique(np.linspace(0, len(shots) - 1, _STRIPS).round().astype(int)).tolist()
    cells = ["<span></span>", *(f"<span>t = {shots[k].t:.2f} s</span>" for k in chosen)]
    for row, name in enumerate(PANELS):
        cells.append(f"<span>{name}</span>")
        for k in chosen:
            alt = f"{name} at {shots[k].t:.2f} s"
            cells.append(f'<img src="{picture_uri(shots[k].panels[row])}" alt="{alt}">')
    columns = f"grid-template-columns: auto repeat({len(chosen)}, minmax(0, 1fr))"
    return f'<div class="strips" style="{columns}">{"".join(cells)}</div>'


def _words(shot: Shot, errors: PoseErrors | None) -> str:
    words = f"t = {shot.t:.3f} s; outlines overlap by {100 * shot.overlap:.1f} %"
    if errors is None:
        return words
    at = int(np.abs(errors.t - shot.t).argmin())
    if abs(errors.t[at] - shot.t) > 1e-6:
        return words
    millimetres, degrees = 1e3 * errors.position[at], np.degrees(errors.rotation[at])
    return f"{words}; {millimetres:.1f} mm and {degrees:.1f}° from ground truth"


def _speeds(seconds: float) -> str:
    """Options of the playback's speed; chosen is the fastest with which the film lasts long enough."""
    slow = [speed for speed in _SPEEDS if seconds / speed >= _COMFORTABLE]
    chosen = slow[0] if slow else _SPEEDS[-1]
    names = {1.0: "real time", 0.5: "1/2 speed", 0.25: "1/4 speed", 0.125: "1/8 speed"}
    marks = {speed: " selected" if speed == chosen else "" for speed in _SPEEDS}
    return "".join(f'<option value="{speed:g}"{marks[speed]}>{name}</option>' for speed, name in names.items())
