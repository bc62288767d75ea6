# SPDX-License-Identifier: MIT
"""Fits 1, 5 and 20 real pushes, and others, and predicts the rest; writes docs/results/real.json."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.real.evaluate import summary
from benchmarks.real.sets import SETS
from benchmarks.real.tables import words

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
    parser.add_argument("--write", action="store_true", help="write docs/results/real.json")
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
                print(job.path.stem, words(summary(cases[-1])), flush=True)
    if given.write:
        write(cases)


def write(cases: Sequence[dict[str, Any]]) -> None:
    """Write all figures, which `python -m benchmarks.result_pages` makes the tables of."""
    text = json.dumps({"cases": [_rounded(case) for case in cases]}, indent=None)
    (_RESULTS / "real.json").write_text(text.replace('{"set"', '\n{"set"') + "\n")


def _rounded(value: Any) -> Any:
    """Figures with six digits."""
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


if __name__ == "__main__":
    main()
