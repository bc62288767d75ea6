"""Table of policies: success and actions of every system, push and flip."""

from collections.abc import Mapping, Sequence

from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.paper.reproduce.evaluations import EvaluationCell, evaluated
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import SYSTEMS
from pinwm_drake.paper.reproduce.tables import paper
from pinwm_drake.paper.reproduce.tables.table import MISSING, Results, Row, Table, percent


def evaluations(request: ReproduceRequest, names: Sequence[str], *, stand_in: bool = False) -> list[EvaluationCell]:
    """Cells of the evaluations of systems, in the stand-in for a robot or not, for a request's tasks and seeds."""
    return [
        evaluated(request, task, name, seed, stand_in=stand_in)
        for task in request.tasks
        for name in request.chosen(names)
        for seed in range(request.seeds)
    ]


def evaluation_rows(
    request: ReproduceRequest,
    names: Sequence[str],
    results: Results,
    known: Mapping[tuple[str, str], str],
    *,
    stand_in: bool = False,
) -> list[Row]:
    """Rows of task, system, training, success, interval, actions, seeds, minutes, and the paper's figures `known`."""
    cells: dict[tuple[str, str], list[EvaluationCell]] = {}
    for cell in evaluations(request, names, stand_in=stand_in):
        cells.setdefault((cell.task, cell.system), []).append(cell)
    return [_row(*key, found, results, known.get(key, paper.NONE)) for key, found in cells.items()]


def _row(task: str, name: str, cells: Sequence[EvaluationCell], results: Results, figure: str) -> Row:
    done = {cell.seed: done for cell in cells if (done := results.get(cell)) is not None}
    if not done:
        return [task, name, SYSTEMS[name].words, MISSING, "", "", "", "", figure]
    each = [one["result"] for one in done.values()]
    columns = [
        [percent(one["success_rate"]) for one in each],
        [" to ".join(map(percent, one["interval_95"])) for one in each],
        [f"{one['steps']['all']['mean']:.1f}" for one in each],
        [str(seed) for seed in done],
        [f"{one['provenance']['minutes']:.0f}" for one in done.values()],
    ]
    return [task, name, SYSTEMS[name].words, *(", ".join(column) for column in columns), figure]


HEADER = (
    "task",
    "system",
    "trained in",
    "success (each seed)",
    "95 % interval (Wilson)",
    "actions, failures included",
    "seeds",
    "minutes of evaluation",
    "paper: success, actions",
)
_RANDOMIZED = ("true-theta", "pin-wm", "domain-rand-4", "domain-rand-2", "domain-rand")


def _policies(request: ReproduceRequest) -> list[Cell]:
    return list(evaluations(request, list(SYSTEMS)))


def _randomization(request: ReproduceRequest) -> list[Cell]:
    return list(evaluations(request, _RANDOMIZED))


POLICIES = Table(
    "policies",
    "Policies",
    HEADER,
    _policies,
    lambda request, results: evaluation_rows(request, list(SYSTEMS), results, paper.POLICIES),
    "All systems in Drake's hydroelastic plant with VTK's images, in which none is trained.",
)
RANDOMIZATION = Table(
    "randomization",
    "Randomization",
    HEADER,
    _randomization,
    lambda request, results: evaluation_rows(request, _RANDOMIZED, results, paper.POLICIES),
    "Training in the true theta, in cousins of the twin, and in ranges that are ever wider.",
)
