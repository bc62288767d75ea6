"""Table of one-step errors: how far a twin is from the plant after one random action."""

from collections.abc import Sequence

from pinwm_drake.experiments.reproduce.cell import Cell
from pinwm_drake.experiments.reproduce.predictions import OneStepCell
from pinwm_drake.experiments.reproduce.request import ReproduceRequest
from pinwm_drake.experiments.reproduce.tables.table import MISSING, Results, Row, Table

_ORIGINS = ("pin-wm", "scene")


def _cells(request: ReproduceRequest) -> list[OneStepCell]:
    return [
        OneStepCell(task, origin, seed, request.draws, None if origin == "scene" else request.twin(task, seed))
        for task in request.tasks
        for origin in _ORIGINS
        for seed in range(request.seeds)
        if origin != "scene" or seed == 0
    ]


def _all(request: ReproduceRequest) -> list[Cell]:
    return list(_cells(request))


def _rows(request: ReproduceRequest, results: Results) -> list[Row]:
    return [_row(cell, results) for cell in _cells(request)]


def _row(cell: OneStepCell, results: Results) -> Row:
    done = results.get(cell)
    name = "the scene's own theta: the engines' difference" if cell.origin == "scene" else cell.origin
    if done is None:
        return [cell.task, name, str(cell.seed), MISSING, "", ""]
    found = done["result"]
    return [cell.task, name, str(cell.seed), *(error_words(found[part], unit) for part, unit in PARTS), str(cell.draws)]


PARTS = (("translation", "mm"), ("rotation", "rad"))


def error_words(found: dict[str, float], unit: str) -> str:
    """Mean, median and 95th percentile of errors, in mm or rad."""
    scale = 1e3 if unit == "mm" else 1.0
    values: Sequence[float] = [scale * found[name] for name in ("mean", "median", "high")]
    return "{:.3g} {unit} (median {:.3g}, 95 % below {:.3g})".format(*values, unit=unit)


ONE_STEP = Table(
    "one-step",
    "One-step errors",
    ("task", "twin", "seed", "translation", "rotation", "draws"),
    _all,
    _rows,
    "Errors of the object's pose after one action of full length towards a random point of the object, against Drake's "
    "hydroelastic plant.",
)
