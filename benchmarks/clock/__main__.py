# SPDX-License-Identifier: MIT
"""Offsets between films and logs, of pushes that are rendered with an arm, a table, clutter and noise.

    python -m benchmarks.clock [--seeds N] [--first S] [--wrong N] [--out docs/results/clock.json]

For each seed the offset is drawn within 1.5 s, found from film and log, and compared. Seeds below 100 served to choose
the constants in `pinwm_drake/station/clock`. The first films are also given wrong inputs, which have to be named.
"""

import argparse
import datetime
import logging
import shlex
import sys
import time
from pathlib import Path

from benchmarks import results, timing

if __name__ == "__main__":
    timing.limit_threads(1)  # before numba and torch are imported

import numpy as np

from benchmarks.clock.scene import RADIUS, FilmedPush, film_push
from pinwm_drake.errors import InputError
from pinwm_drake.station.clock.find import find_clock
from pinwm_drake.station.clock.patches import PusherFilm, box_of_way

FILM = Path("push.mp4")
BOUNDS = np.array([[-RADIUS] * 3, [RADIUS] * 3])
CUT, FASTER, AWAY = 0.25, 1.2, 4.0  # s, 1, s
# Words by which each wrong input has to be named.
NAMES = dict.fromkeys(("rate", "away"), "another clock") | {"other run": "another run"}
NAMES |= {name: name for name in ("mirrored", "cut")}


def seen(push: FilmedPush, frames: np.ndarray, t: np.ndarray, log: tuple[np.ndarray, np.ndarray]) -> PusherFilm:
    """Film and log as the command hands them to the search."""
    x, y, width, height = box_of_way(log[1], push.camera, push.X_WC, BOUNDS)
    cut = [np.ascontiguousarray(frame[y : y + height, x : x + width]) for frame in frames]
    return PusherFilm(cut, t, *log, push.camera.cropped(x, y, width, height), push.X_WC, BOUNDS)


def wrong_inputs(push: FilmedPush) -> dict[str, PusherFilm]:
    """Return the push with each of the wrong inputs."""
    log, frames, t = (push.log_t, push.p_WP), push.frames, push.t
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(push.p_WP, axis=0), axis=1))])
    middle = float(np.interp(0.5 * way[-1], way, push.log_t)) - push.offset
    kept = (t < middle) | (t >= middle + CUT)
    return {
        "mirrored": seen(push, frames[:, :, ::-1], t, log),
        "cut": seen(push, frames[kept], t[: kept.sum()], log),
        "other run": seen(push, frames, t, push.other),
        "rate": seen(push, frames, t / FASTER, log),
        "away": seen(push, frames, t + AWAY, log),
    }


def tried(film: PusherFilm) -> str:
    """Line that names what is wrong, or the offset that was found."""
    try:
        fit = find_clock(film, FILM)
    except InputError as error:
        return str(error)
    return f"found {fit.offset:.3f} s"


def main() -> None:
    """Print a row for each seed, and the table; write both with `--out`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--wrong", type=int, default=20, help="films that are given wrong inputs too")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    logging.getLogger("drake").setLevel(logging.ERROR)
    rows, lines = [], []
    for seed in range(given.first, given.first + given.seeds):
        push = film_push(seed)
        row: dict[str, object] = {"seed": seed, "frames": len(push.t), "offset": push.offset}
        start = time.process_time()
        try:
            fit = find_clock(seen(push, push.frames, push.t, (push.log_t, push.p_WP)), FILM)
            row |= {"error": fit.offset - push.offset, "deviation": fit.deviation, "rate": fit.rate}
        except InputError as error:
            row["refused"] = str(error)
        row["seconds"] = round(time.process_time() - start, 2)
        rows.append(row)
        print(row, flush=True)
        if seed < given.first + given.wrong:
            lines.append({"seed": seed} | {name: tried(film) for name, film in wrong_inputs(push).items()})
            print(lines[-1], flush=True)
    figures = summary(rows, lines)
    print("\n".join(results.markdown("what | value", figures.items())))
    command, date = f"python -m benchmarks.clock {shlex.join(sys.argv[1:])}", datetime.date.today().isoformat()
    results.write_json(given.out, command=command, date=date, summary=figures, films=rows, wrong_inputs=lines)


def summary(rows: list[dict], lines: list[dict]) -> dict[str, str]:
    """Figures in words, by what they are of."""
    fitted = [row for row in rows if "error" in row]
    errors, deviations = (np.array([row[key] for row in fitted]) for key in ("error", "deviation"))
    inside = int((np.abs(errors) <= 1.96 * deviations).sum())
    within = int((np.abs(errors) <= 5e-3).sum())
    found = {
        "offsets within 5 ms": f"{within} of {len(rows)}",
        "error, median and largest": f"{1e3 * np.median(np.abs(errors)):.2f} ms, {1e3 * np.abs(errors).max():.2f} ms",
        "95 % intervals that hold the offset": f"{inside} of {len(fitted)}",
        "half widths of the intervals, median": f"{1.96e3 * np.median(deviations):.1f} ms",
        "refused": str(len(rows) - len(fitted)),
        "CPU time of a film, median": f"{np.median([row['seconds'] for row in rows]):.1f} s",
    }
    for name, words in NAMES.items():
        if lines:
            found[f"wrong input named: {name}"] = f"{sum(words in line[name] for line in lines)} of {len(lines)}"
    return found


if __name__ == "__main__":
    main()
