"""Table of one-step errors: how far a system's prediction is from the plant after one random action."""

from collections.abc import Sequence

from pinwm_drake.experiments.reproduce.cell import Cell
from pinwm_drake.experiments.reproduce.imagined_steps import ImaginedStepCell, SeenOutcomesCell
from pinwm_drake.experiments.reproduce.predictions import OneStepCell, OutcomesCell
from pinwm_drake.experiments.reproduce.request import ReproduceRequest
from pinwm_drake.experiments.reproduce.systems import ASID, ASID_GENEROUS, DREAMER, PIN_WM, PLANAR, SCENE
from pinwm_drake.experiments.reproduce.tables import paper
from pinwm_drake.experiments.reproduce.tables.table import MISSING, Results, Row, Table
from pinwm_drake.experiments.reproduce.trajectories import dreamer

_SYSTEMS = (PIN_WM, ASID, ASID_GENEROUS, PLANAR, DREAMER)
_READOUT = "readout of true images: what reading a pose adds"
_ENGINES = "the scene's own theta: the engines' difference"


def _cells(request: ReproduceRequest) -> list[tuple[Row, Cell]]:
    """Task, name and seed of each row, and its cell; the scene's own theta is always there."""
    found: list[tuple[Row, Cell]] = []
    for task in request.tasks:
        outcomes, names = request.outcomes(task), request.chosen(_SYSTEMS)
        for name in names:
            for seed in range(request.seeds):
                found.append(((task, name, str(seed)), _cell(request, outcomes, name, seed)))
        if DREAMER in names:
            found.append(((task, _READOUT, ""), SeenOutcomesCell(outcomes)))
        found.append(((task, _ENGINES, ""), OneStepCell(SCENE, outcomes, None)))
    return found


def _cell(request: ReproduceRequest, outcomes: OutcomesCell, name: str, seed: int) -> Cell:
    """Cell of a system's errors after the actions."""
    if name == DREAMER:
        return ImaginedStepCell(SeenOutcomesCell(outcomes), dreamer(outcomes.task, seed, request.quick))
    if name == PIN_WM:
        return OneStepCell(name, outcomes, request.twin(outcomes.task, seed), curve=True)
    return OneStepCell(name, outcomes, request.tracked(outcomes.task, seed, name))


def _all(request: ReproduceRequest) -> list[Cell]:
    return [cell for _, cell in _cells(request)]


def _rows(request: ReproduceRequest, results: Results) -> list[Row]:
    rows: list[Row] = []
    for head, cell in _cells(request):
        done = results.get(cell)
        words = [MISSING, ""] if done is None else [error_words(done["result"][part], unit) for part, unit in PARTS]
        rows.append([*head, *words, str(request.draws), paper.ONE_STEP.get((head[0], head[1]), paper.NONE)])
    return rows


PARTS = (("translation", "mm"), ("rotation", "rad"))


def error_words(found: dict[str, float], unit: str) -> str:
    """Mean, median and 95th percentile of errors, in mm or rad."""
    scale = 1e3 if unit == "mm" else 1.0
    values: Sequence[float] = [scale * found[name] for name in ("mean", "median", "high")]
    return "{:.3g} {unit} (median {:.3g}, 95 % below {:.3g})".format(*values, unit=unit)


ONE_STEP = Table(
    "one-step",
    "One-step errors",
    ("task", "prediction", "seed", "translation", "rotation", "draws", "paper"),
    _all,
    _rows,
    "Errors of the object's pose when one action towards a random point of the object ends, as long as those that "
    "policies take, against Drake's hydroelastic plant; the object still moves then. Dreamer V2 predicts images, from "
    "which poses are read by the rendering loss; the error of that alone is the row of the plant's own images.",
)
