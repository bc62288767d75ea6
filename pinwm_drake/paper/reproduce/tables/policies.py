"""Tables of policies: success and actions of systems, of which each is trained in something else."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from pinwm_drake.paper.reproduce.policies import EvaluationCell, evaluated
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import NO_COUSINS, PIN_WM, SYSTEMS
from pinwm_drake.paper.reproduce.tables import paper
from pinwm_drake.paper.reproduce.tables.table import MISSING, NONE, Line, Results, Table

_HEADER = (
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
_OBJECTS = ("push", "push-cube", "push-large-t", "flip-cube")
_TRIALS = 20  # of a system, in the stand-in for a robot


def _lines(
    names: Sequence[str],
    known: Mapping[tuple[str, str], str],
    request: ReproduceRequest,
    *,
    stand_in: bool = False,
) -> list[Line]:
    """Lines of systems, in the stand-in for a robot or not, for a request's tasks, with the paper's figures `known`."""
    lines = []
    for task in request.tasks:
        for name in request.chosen(names):
            cells = [evaluated(request, task, name, seed, stand_in=stand_in) for seed in range(request.seeds)]
            lines.append(Line((task, name, SYSTEMS[name].words), cells, (known.get((task, name), NONE),)))
    return lines


def _of_objects(request: ReproduceRequest) -> list[Line]:
    """Lines of the scenes whose kind of task is asked for, or that are named."""
    chosen = tuple(name for name in _OBJECTS if name in request.tasks or name.split("-")[0] in request.tasks)
    return _lines((PIN_WM, NO_COUSINS), paper.TASKS, replace(request, tasks=chosen))


def _in_stand_in(request: ReproduceRequest) -> list[Line]:
    few = replace(request, episodes=min(request.episodes, _TRIALS))
    return _lines(list(SYSTEMS), paper.ROBOT, few, stand_in=True)


def _columns(cells: Sequence[EvaluationCell], results: Results) -> list[str]:
    """Success, interval, actions, seeds and minutes of the evaluations that are done."""
    done = {cell.seed: done for cell in cells if (done := results.get(cell)) is not None}
    if not done:
        return [MISSING, "", "", "", ""]
    each = [one["result"] for one in done.values()]
    columns = [
        [_percent(one["success_rate"]) for one in each],
        [" to ".join(map(_percent, one["interval_95"])) for one in each],
        [f"{one['steps']['all']['mean']:.1f}" for one in each],
        [str(seed) for seed in done],
        [f"{one['provenance']['minutes']:.0f}" for one in done.values()],
    ]
    return [", ".join(column) for column in columns]


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


POLICIES = Table(
    "policies",
    "Policies",
    _HEADER,
    partial(_lines, list(SYSTEMS), paper.POLICIES),
    _columns,
    "All systems in Drake's hydroelastic plant with VTK's images, in which none is trained.",
)
RANDOMIZATION = Table(
    "randomization",
    "Randomization",
    _HEADER,
    partial(_lines, _RANDOMIZED, paper.POLICIES),
    _columns,
    "Training in the true theta, in cousins of the twin, and in ranges that are ever wider.",
)
TASKS_TABLE = Table(
    "tasks",
    "Tasks",
    _HEADER,
    _of_objects,
    _columns,
    "Slippery floor (0.03): T-block, cube and a larger T-block, pushed. Rough floor (0.2): a cube, turned over.",
)
STAND_IN = Table(
    "stand-in",
    "Stand-in for a robot",
    _HEADER,
    _in_stand_in,
    _columns,
    "No robot: the plant of the other tables with a lump in the object and feet below it, a camera 3 mm and 0.5 "
    "degrees off, actions 80 ms late, ragged masks and one lamp. Filmed, recorded and trained for it, with actions 70 "
    "to 90 ms late, as of a lab that has measured them. 20 trials, all on one such station.",
)
