# SPDX-License-Identifier: MIT
"""Where a flip can be done: the best of random strokes that are told θ, over frictions, delays and speeds.

    python -m benchmarks.flip_frontier [--scene SCENE ...] [--strokes N] [--out FILE]

Each cell has a search of its own (`find_waypoints`) in the twin with the cell's frictions: strokes in the plane of
object and pusher, sieved by their mean reward from several starts. Its figure is the share of 64 other starts from
which the best stroke does the task, without feedback. A policy that sees the object does more: it can correct itself.
"""

import argparse
import dataclasses
import json
import tempfile
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks import timing

if __name__ == "__main__":
    timing.limit_threads(1)  # before numba and torch are imported

from benchmarks.results import markdown, write_json
from pinwm_drake.cousins.domain import CousinDomains
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds, training_options
from pinwm_drake.systems.mpc.waypoints import WaypointOptions, find_waypoints
from pinwm_drake.systems.scenario.load import load_setup

SCENES = ("flip_mug", "flip_mug_handle", "flip_cube")
FLOOR, PUSHER = (0.05, 0.1, 0.2, 0.3, 0.5), (0.3, 0.45, 0.6, 0.9, 1.2)
NEAR = (0.45, 0.6, 0.9), (0.1, 0.2, 0.3)  # pusher and floor, of the first scene with these:
SPEED, MORE = 1.25, ((0.08, 1.25), (0.0, 1.0), (0.0, 0.5))  # m/s; delay [s] and speed [m/s] beside no delay and that
NAMES = ("scene", "pusher", "floor", "latency", "speed")
WORLDS = 64


def share(scene: str, floor: float, pusher: float, latency: float, speed: float, strokes: int) -> float:
    """Share of 64 starts from which the best stroke does the task."""
    setup = load_setup(scene).with_theta(friction_floor=floor, friction_pusher=pusher)
    limits = dataclasses.replace(setup.scenario.pusher, max_speed=speed)
    setup = dataclasses.replace(setup, scenario=dataclasses.replace(setup.scenario, pusher=limits))
    worlds = TrainingWorlds(
        setup, training_options(latency=(latency, latency)), num_worlds=WORLDS, domains=CousinDomains(0.0)
    )
    options = WaypointOptions(
        strokes=strokes, sieves=((1, strokes // 16), (8, 16), (32, 1)), attempts=1, replays=1, noise=0.0, rounds=0
    )
    steps: list[Any] = []
    with tempfile.TemporaryDirectory() as folder:
        find_waypoints(worlds, Path(folder), options, report=steps.append)
    return float(steps[-1].best)


def table(rows: list[dict[str, Any]]) -> str:
    """Table in Markdown: a line for each scene, delay, speed and friction of the pusher."""
    floors, lines = sorted({row["floor"] for row in rows}), []
    keys = sorted({(row["scene"], row["latency"], row["speed"], row["pusher"]) for row in rows})
    for key in keys:
        found = {
            row["floor"]: f"{100 * row['share']:.0f} %"
            for row in rows
            if (row["scene"], row["latency"], row["speed"], row["pusher"]) == key
        }
        scene, latency, speed, pusher = key
        cells = [found.get(floor, "") for floor in floors]
        lines.append([f"`{scene}`", f"{1e3 * latency:g} ms", f"{speed:g} m/s", f"{pusher:g}", *cells])
    header = "scene | delay | speed | pusher | " + " | ".join(f"floor {floor:g}" for floor in floors)
    return "\n".join(markdown(header, lines))


def main() -> None:
    """Search each cell, and print or store the shares; cells that the file has are not searched again."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="+", default=SCENES)
    parser.add_argument("--strokes", type=int, default=2048)
    parser.add_argument("--out", type=Path, help="JSON file of the results")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if given.out is not None and given.out.exists():
        stored = json.loads(given.out.read_text())
        if stored["strokes"] != given.strokes:
            parser.error(f"--strokes: got {given.strokes}; allowed: {stored['strokes']}, as {given.out} has them")
        rows = stored["results"]
    cells = [(scene, *one, 0.0, SPEED) for scene in given.scene for one in product(PUSHER, FLOOR)]
    cells += [(scene, *one, *more) for scene in given.scene[:1] for more in MORE for one in product(*NEAR)]
    for scene, pusher, floor, latency, speed in cells:
        if (scene, pusher, floor, latency, speed) in [tuple(row[name] for name in NAMES) for row in rows]:
            continue
        found = share(scene, floor, pusher, latency, speed, given.strokes)
        cell = dict(zip(NAMES, (scene, pusher, floor, latency, speed), strict=True))
        rows.append(cell | {"share": found})
        print(rows[-1], flush=True)
        write_json(given.out, strokes=given.strokes, starts=WORLDS, results=rows)
    print(f"\n{table(rows)}")


if __name__ == "__main__":
    main()
