"""Table of one-step errors: how far a twin is from the plant after one random action."""

from collections.abc import Sequence

from pinwm_drake.experiments.reproduce.cell import Cell
from pinwm_drake.experiments.reproduce.predictions import OneStepCell, OutcomesCell
from pinwm_drake.experiments.reproduce.request import ReproduceRequest
from pinwm_drake.experiments.reproduce.systems import ASID, ASID_GENEROUS, PLANAR
from pinwm_drake.experiments.reproduce.tables.table import MISSING, Results, Row, Table


def _cells(request: ReproduceRequest) -> list[OneStepCell]:
    found = []
    for task in request.tasks:
        outcomes = OutcomesCell(task, request.draws)
        twins = [request.twin(task, seed) for seed in range(request.seeds)]
        found += [OneStepCell(twin.system, outcomes, twin, curve=True) for twin in twins]
        for system in (ASID, ASID_GENEROUS, PLANAR):
            others = [request.tracked(task, seed, system) for seed in range(request.seeds)]
            found += [OneStepCell(system, outcomes, twin) for twin in others]
        found.append(OneStepCell("scene", outcomes, None))
    return found


def _all(request: ReproduceRequest) -> list[Cell]:
    return list(_cells(request))


def _rows(request: ReproduceRequest, results: Results) -> list[Row]:
    return [_row(cell, results) for cell in _cells(request)]


def _row(cell: OneStepCell, results: Results) -> Row:
    done = results.get(cell)
    name = "the scene's own theta: the engines' difference" if cell.origin == "scene" else cell.origin
    task, draws = cell.outcomes.task, str(cell.outcomes.draws)
    seed = "" if cell.twin is None else str(cell.twin.surfels.capture.seed)
    if done is None:
        return [task, name, seed, MISSING, "", draws]
    return [task, name, seed, *(error_words(done["result"][part], unit) for part, unit in PARTS), draws]


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
