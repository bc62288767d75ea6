"""Table of one-step errors: how far a system's prediction is from the plant after one random action."""

from collections.abc import Sequence

from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.paper.reproduce.imagined_steps import ImaginedStepCell, SeenOutcomesCell
from pinwm_drake.paper.reproduce.predictions import OneStepCell
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import ASID, ASID_GENEROUS, DREAMER, PIN_WM, PLANAR, SCENE
from pinwm_drake.paper.reproduce.tables import paper
from pinwm_drake.paper.reproduce.tables.table import MISSING, Results, Row, Table
from pinwm_drake.paper.reproduce.trajectories import dreamer

_SYSTEMS = (PIN_WM, ASID, ASID_GENEROUS, PLANAR, DREAMER)
_READOUT = "readout of true images: what reading a pose adds"
_ENGINES = "the scene's own theta: the engines' difference"


def _cells(request: ReproduceRequest) -> list[tuple[Row, Cell, OneStepCell | None]]:
    """Task, name and seed of each row, its cell, and that of the object at rest; the scene's own theta is always there.

    What is read from images is not followed to rest.
    """
    found: list[tuple[Row, Cell, OneStepCell | None]] = []
    for task in request.tasks:
        outcomes, names = request.outcomes(task), request.chosen(_SYSTEMS)
        at_rest = request.outcomes(task, at_rest=True)
        for name in names:
            for seed in range(request.seeds):
                head = (task, name, str(seed))
                if name == DREAMER:
                    imagined = ImaginedStepCell(SeenOutcomesCell(outcomes), dreamer(task, seed, request.quick))
                    found.append((head, imagined, None))
                    continue
                own = name == PIN_WM
                twin = request.twin(task, seed) if own else request.tracked(task, seed, name)
                found.append((head, OneStepCell(name, outcomes, twin, curve=own), OneStepCell(name, at_rest, twin)))
        if DREAMER in names:
            found.append(((task, _READOUT, ""), SeenOutcomesCell(outcomes), None))
        found.append(((task, _ENGINES, ""), OneStepCell(SCENE, outcomes, None), OneStepCell(SCENE, at_rest, None)))
    return found


def _all(request: ReproduceRequest) -> list[Cell]:
    return [cell for _, *cells in _cells(request) for cell in cells if cell is not None]


def _rows(request: ReproduceRequest, results: Results) -> list[Row]:
    rows: list[Row] = []
    for head, *cells in _cells(request):
        words: list[str] = []
        for cell in cells:
            if cell is None:
                words += [paper.NONE, paper.NONE]
            elif (done := results.get(cell)) is None:
                words += [MISSING, ""]
            else:
                words += [error_words(done["result"][part], unit) for part, unit in PARTS]
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
    (
        "task",
        "prediction",
        "seed",
        "translation",
        "rotation",
        "translation at rest",
        "rotation at rest",
        "draws",
        "paper",
    ),
    _all,
    _rows,
    "Errors of the object's pose after one action towards a random point of the object, as long as those that policies "
    "take, against Drake's hydroelastic plant: when the action ends, while the object still moves, and when it rests, "
    "2 s later at the most. Dreamer V2 predicts images, from which poses are read by the rendering loss; the "
    "error of that alone is the row of the plant's own images.",
)
