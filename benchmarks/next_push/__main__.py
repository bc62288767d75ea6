# SPDX-License-Identifier: MIT
"""Command line of the benchmark.

    python -m benchmarks.next_push captures OUT [--only NAME ...] [--poses-only] [--realistic]
    python -m benchmarks.next_push coverage OUT [--number N] [--first K] [--step S]
    python -m benchmarks.next_push evaluate OUT [--only NAME ...] [--split SPLIT] [--kind KIND] [--methods ...]
        [--pushes ...] [--sets N] [--existing]

Clean captures come to OUT/clean/NAME, their poses to OUT/poses/NAME.npz; realistic ones to OUT/realistic/NAME, with
OUT/realistic_poses/NAME.npz and what is wrong with them in OUT/realistic_poses/NAME.json.
"""

import argparse
import itertools
import json
import time
from pathlib import Path

import numpy as np

from benchmarks.next_push.captures import write_capture
from benchmarks.next_push.coverage import coverage_case, coverage_table, rank_histogram
from benchmarks.next_push.evaluate import METHODS, SETS, evaluate, result_path, summary, table
from benchmarks.next_push.objects import OBJECTS, Thing, make_thing
from benchmarks.next_push.poses import pose_capture, read_poses, write_poses
from benchmarks.next_push.specification import CAPTURES, CaptureSpec, uneven
from pinwm_drake.files import replacing
from pinwm_drake.systems.runs.realism.mistakes import Realism


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.next_push")
    commands = parser.add_subparsers(required=True)
    captures = commands.add_parser("captures", help="make the captures; those that are there stay")
    captures.add_argument("out", type=Path)
    captures.add_argument("--only", nargs="+", metavar="NAME", help="names of captures; all of them by default")
    captures.add_argument("--poses-only", action="store_true", help="no pictures")
    captures.add_argument("--realistic", action="store_true", help="as a lab has them, instead of clean")
    captures.set_defaults(run=_captures)
    tables = commands.add_parser("evaluate", help="twins and predictions, and the table of them; what is there stays")
    tables.add_argument("out", type=Path)
    tables.add_argument("--only", nargs="+", metavar="NAME", help="names of captures; all of them by default")
    tables.add_argument("--split", choices=("tuning", "unseen"), help="only these captures")
    tables.add_argument("--kind", choices=("clean", "realistic"), default="clean")
    tables.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    tables.add_argument("--pushes", nargs="+", type=int, choices=(1, 2, 3), default=[1, 2, 3])
    tables.add_argument("--sets", type=int, default=4, help="sets of each number of pushes, at the most")
    tables.add_argument("--existing", action="store_true", help="nothing new, only the table of what is there")
    tables.set_defaults(run=_evaluate)
    covered = commands.add_parser("coverage", help="ranks of the truth in short captures; what is there stays")
    covered.add_argument("out", type=Path)
    covered.add_argument("--number", type=int, default=200, help="captures")
    covered.add_argument("--first", type=int, default=0, help="number of the first capture that is made now")
    covered.add_argument("--step", type=int, default=1, help="of how many, one is made now: for several processes")
    covered.set_defaults(run=_coverage)
    arguments = parser.parse_args()
    arguments.run(arguments)


def _evaluate(arguments: argparse.Namespace) -> None:
    results = []
    for spec, method, number, place in itertools.product(CAPTURES, arguments.methods, range(4), range(4)):
        asked = {"ours": arguments.pushes, "pin-wm": [1]}.get(method, [0])
        if (arguments.only and spec.name not in arguments.only) or arguments.split not in (None, spec.split):
            continue
        if number not in asked or place >= min(len(SETS[number]), arguments.sets):
            continue
        began, chosen = time.perf_counter(), SETS[number][place]
        if arguments.existing and not result_path(arguments.out, arguments.kind, spec, method, chosen).exists():
            continue
        found = evaluate(arguments.out, arguments.kind, spec, method, chosen)
        results.append(found)
        _say(spec, f"{method} {' and '.join(map(str, chosen))}: {summary([found])}", began)
    print("\n".join(table(results)))


def _coverage(arguments: argparse.Namespace) -> None:
    rows = []
    for number in range(arguments.first, arguments.number, arguments.step):
        began = time.perf_counter()
        row = coverage_case(arguments.out, number)
        rows.append(row)
        ranks = " ".join(f"{name} {rank:.2f}" for name, rank in row["ranks"].items())
        print(f"{number} {row['capture']}: {ranks}, {time.perf_counter() - began:.0f} s", flush=True)
    print("\n".join(coverage_table(rows)))
    rank_histogram(arguments.out / "coverage" / "ranks.png", rows)


def _captures(arguments: argparse.Namespace) -> None:
    names = [spec.name for spec in CAPTURES]
    for name in arguments.only or ():
        if name not in names:
            raise SystemExit(f"--only: got {name!r}; allowed: {', '.join(names)}")
    things = {name: make_thing(name, arguments.out / "objects") for name in OBJECTS}
    for spec in CAPTURES:
        if not arguments.only or spec.name in arguments.only:
            _make(arguments, spec, things[spec.thing])


def _make(arguments: argparse.Namespace, spec: CaptureSpec, thing: Thing) -> None:
    kind, realistic = ("realistic", True) if arguments.realistic else ("clean", False)
    path = arguments.out / ("realistic_poses" if realistic else "poses") / f"{spec.name}.npz"
    folder, began = arguments.out / kind / spec.name, time.perf_counter()
    if not path.exists():
        theta = uneven(thing, spec.theta(thing), np.random.default_rng([spec.seed, 6])) if realistic else None
        write_poses(path, spec, thing, pose_capture(spec, thing, theta))
        _say(spec, f"{kind} poses", began)
    if not arguments.poses_only and not folder.exists():
        mistakes = write_capture(folder, spec, thing, read_poses(path), realism=Realism() if realistic else None)
        if realistic:
            with replacing(path.with_suffix(".json")) as temporary:
                temporary.write_text(json.dumps(mistakes, indent=1) + "\n", encoding="utf-8")
        _say(spec, f"{kind} capture", began)


def _say(spec: CaptureSpec, what: str, began: float) -> None:
    print(f"{spec.name}: {what}, {time.perf_counter() - began:.0f} s", flush=True)


main()
