"""Table of the stand-in for a robot: success and actions of every system where nothing is quite as it is believed."""

from dataclasses import replace

from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import SYSTEMS
from pinwm_drake.paper.reproduce.tables import paper
from pinwm_drake.paper.reproduce.tables.policies import HEADER, evaluation_rows, evaluations
from pinwm_drake.paper.reproduce.tables.table import Results, Row, Table

_EPISODES = 20  # of a system


def _cells(request: ReproduceRequest) -> list[Cell]:
    return list(evaluations(_few(request), list(SYSTEMS), stand_in=True))


def _rows(request: ReproduceRequest, results: Results) -> list[Row]:
    return evaluation_rows(_few(request), list(SYSTEMS), results, paper.ROBOT, stand_in=True)


def _few(request: ReproduceRequest) -> ReproduceRequest:
    """The request with 20 episodes at the most."""
    return replace(request, episodes=min(request.episodes, _EPISODES))


STAND_IN = Table(
    "stand-in",
    "Stand-in for a robot",
    HEADER,
    _cells,
    _rows,
    "No robot: the plant of the other tables with a lump in the object and feet below it, a camera 3 mm and 0.5 "
    "degrees off, actions 80 ms late, ragged masks and one lamp. Filmed, recorded and trained for it, with actions 70 "
    "to 90 ms late, as of a lab that has measured them. 20 trials, all on one such station.",
)
