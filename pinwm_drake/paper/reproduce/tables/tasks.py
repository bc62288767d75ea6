"""Table of tasks: other objects, each with a policy that was trained in cousins of its own twin."""

from dataclasses import replace

from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import NO_COUSINS, PIN_WM
from pinwm_drake.paper.reproduce.tables import paper
from pinwm_drake.paper.reproduce.tables.policies import HEADER, evaluation_rows, evaluations
from pinwm_drake.paper.reproduce.tables.table import Results, Row, Table

_SCENES = ("push", "push-cube", "push-large-t", "flip-cube")
_SYSTEMS = (PIN_WM, NO_COUSINS)


def _cells(request: ReproduceRequest) -> list[Cell]:
    return list(evaluations(replace(request, tasks=_chosen(request)), _SYSTEMS))


def _rows(request: ReproduceRequest, results: Results) -> list[Row]:
    return evaluation_rows(replace(request, tasks=_chosen(request)), _SYSTEMS, results, paper.TASKS)


def _chosen(request: ReproduceRequest) -> tuple[str, ...]:
    """Scenes of the table whose kind of task is asked for, or that are named."""
    return tuple(name for name in _SCENES if name in request.tasks or name.split("-")[0] in request.tasks)


TASKS_TABLE = Table(
    "tasks",
    "Tasks",
    HEADER,
    _cells,
    _rows,
    "Slippery floor (0.03): T-block, cube and a larger T-block, pushed. Rough floor (0.2): a cube, turned over.",
)
