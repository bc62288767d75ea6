# SPDX-License-Identifier: MIT
"""Tables of real measurements from the cases of docs/results/real.json."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.real.evaluate import summary
from benchmarks.results import markdown


def mit(cases: Sequence[dict[str, Any]]) -> str:
    """Return a table of MIT's pairs, with CMU's models beside."""
    found = [case for case in cases if case["set"] == "mit"]
    rows, means = [], []
    for name in sorted({case["name"] for case in found}):
        of = [case for case in found if case["name"] == name]
        by = [[case for case in of if case["number"] == number] for number in (1, 5, 20)]
        means.append([_pooled(some) if some else None for some in by])
        cmu = [of[0]["cmu"]["quartic"], of[0]["cmu"]["quadratic"]]
        rows.append([name, _pair(of[0]["still"]), *(words(one) if one else "" for one in means[-1]), *map(_pair, cmu)])
    rows.append(["mean of those run", "", *map(_mean, zip(*means, strict=True)), "", ""])
    header = "pair | stands still | 1 push | 5 pushes | 20 pushes | CMU's quartic | CMU's quadratic"
    return "\n".join(markdown(header, rows))


def triangle(cases: Sequence[dict[str, Any]]) -> str:
    """Return a table of CMU's triangle: supports, and errors."""
    rows = []
    for case in cases:
        if case["set"] == "triangle":
            found = [case["estimates"][f"support_{axis}"][0] for axis in "xy"]
            known = ", ".join(f"{value:g}" for value in case["points"])
            errors = words(summary(case))
            rows.append([case["name"], known, ", ".join(f"{one:.2f}" for one in found), _pair(case["still"]), errors])
    return "\n".join(markdown("set | spread of its points, x, y | found | stands still | from 10 pushes", rows))


def others(cases: Sequence[dict[str, Any]]) -> str:
    """Return a table of the steel plate and the tosses."""
    rows = []
    for case in cases:
        if case["set"] not in ("mit", "triangle"):
            found = summary(case)
            path = f"{found['path_mm']:.1f}, {found['path_deg']:.1f}"
            rows.append([case["set"], case["number"], found["number"], path, words(found)])
    return "\n".join(markdown("set | fitted | predicted | over the path | at the end", rows))


def _mean(column: Iterable[dict[str, float] | None]) -> str:
    """Mean over the pairs of a column."""
    found = [one for one in column if one]
    return words({key: float(np.mean([one[key] for one in found])) for key in found[0]}) if found else ""


def _pooled(cases: Sequence[dict[str, Any]]) -> dict[str, float]:
    return summary({**cases[0], "predictions": [row for case in cases for row in case["predictions"]]})


def _pair(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


def words(found: dict[str, float]) -> str:
    """Mean errors of the last pose in mm and deg, and the share that 95 % intervals hold."""
    return f"{found['mm']:.2f}, {found['deg']:.2f} ({100 * found['cover']:.0f} %)"
