# SPDX-License-Identifier: MIT
"""Fits 1, 5 and 20 real pushes, and others, and predicts the rest; writes docs/results/real.json and its tables."""

import argparse
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.real.evaluate import summary
from benchmarks.real.sets import SETS
from benchmarks.results import machine, markdown, write_block

_ROOT = Path(__file__).resolve().parent.parent.parent
_RESULTS = _ROOT / "docs/results"
_TESTS = {"mit": 60, "triangle": 35, "steel": 9, "images": 9, "tosses": 96}


def main() -> None:
    """Run the named sets; goes on where it was stopped."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.real", description=__doc__)
    parser.add_argument("sets", nargs="*", help=f"any of {', '.join(SETS)}; default: all", metavar="set")
    parser.add_argument("--data", type=Path, default=_ROOT.parent / "shared/data/real", help="folder of the data")
    parser.add_argument("--out", type=Path, default=Path("out/real"), help="folder for captures, twins and figures")
    parser.add_argument("--only", default="", help="part of the name of the cases to run")
    parser.add_argument("--stored", action="store_true", help="run nothing: use the figures that are stored in --out")
    parser.add_argument("--write", action="store_true", help="write docs/results/real.json and the tables of real.md")
    given = parser.parse_args()
    unknown = [name for name in given.sets if name not in SETS]
    if unknown:
        parser.error(f"unknown: {', '.join(unknown)}; allowed: {', '.join(SETS)}")
    if not given.data.is_dir():
        parser.error(f"--data: got {given.data}, no such folder; allowed: the folder of the real measurements")
    cases = []
    for name in given.sets or SETS:
        for job in SETS[name](given.data, given.out, _TESTS[name]):
            if given.only in job.path.stem and (job.path.is_file() or not given.stored):
                cases.append(job.run())
                print(job.path.stem, _words(summary(cases[-1]["predictions"])), flush=True)
    if given.write:
        write(cases)


def write(cases: Sequence[dict[str, Any]]) -> None:
    """Write all figures, and tables of them, on the page of results."""
    cases = [_rounded(case) for case in cases]
    text = json.dumps({"machine": machine(), "cases": cases}, indent=None)
    (_RESULTS / "real.json").write_text(text.replace('{"set"', '\n{"set"') + "\n")
    page, command = _RESULTS / "real.md", "python -m benchmarks.real --write"
    for name, table in (("mit", _mit), ("triangle", _triangle), ("others", _others)):
        write_block(page, name, "\n".join(table(cases)), command)


def _mit(cases: Sequence[dict[str, Any]]) -> list[str]:
    found = [case for case in cases if case["set"] == "mit"]
    rows, means = [], []
    for name in sorted({case["name"] for case in found}):
        of = [case for case in found if case["name"] == name]
        by = [[case for case in of if case["number"] == number] for number in (1, 5, 20)]
        means.append([_pooled(some) if some else None for some in by])
        cmu = [of[0]["cmu"]["quartic"], of[0]["cmu"]["quadratic"]]
        rows.append([name, _pair(of[0]["still"]), *(_words(one) if one else "" for one in means[-1]), *map(_pair, cmu)])
    rows.append(["mean of those run", "", *map(_mean, zip(*means, strict=True)), "", ""])
    return markdown("pair | stands still | 1 push | 5 pushes | 20 pushes | CMU's quartic | CMU's quadratic", rows)


def _triangle(cases: Sequence[dict[str, Any]]) -> list[str]:
    rows = []
    for case in cases:
        if case["set"] == "triangle":
            found = [case["estimates"][f"support_{axis}"][0] for axis in "xy"]
            known = ", ".join(f"{value:g}" for value in case["points"])
            words = _words(summary(case["predictions"]))
            rows.append([case["name"], known, ", ".join(f"{one:.2f}" for one in found), _pair(case["still"]), words])
    return markdown("set | spread of its points, x, y | found | stands still | from 10 pushes", rows)


def _others(cases: Sequence[dict[str, Any]]) -> list[str]:
    rows = []
    for case in cases:
        if case["set"] not in ("mit", "triangle"):
            found = summary(case["predictions"])
            path = f"{found['path_mm']:.1f}, {found['path_deg']:.1f}"
            rows.append([case["set"], case["number"], found["number"], path, _words(found)])
    return markdown("set | fitted | predicted | over the path | at the end", rows)


def _mean(column: Iterable[dict[str, float] | None]) -> str:
    """Mean over the pairs of a column."""
    found = [one for one in column if one]
    return _words({key: float(np.mean([one[key] for one in found])) for key in found[0]}) if found else ""


def _pooled(cases: Sequence[dict[str, Any]]) -> dict[str, float]:
    return summary([row for case in cases for row in case["predictions"]])


def _pair(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


def _words(found: dict[str, float]) -> str:
    """Mean errors of the last pose in mm and deg, and the share that 95 % intervals hold."""
    return f"{found['mm']:.2f}, {found['deg']:.2f} ({100 * found['cover']:.0f} %)"


def _rounded(value: Any) -> Any:
    """Figures with six digits, without the names of pushes that nobody reads."""
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


if __name__ == "__main__":
    main()
