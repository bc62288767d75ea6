"""Table of parameters: one physical unknown is identified at a time, while the others have their true values."""

from pinwm_drake.experiments.reproduce.cell import Cell
from pinwm_drake.experiments.reproduce.request import ReproduceRequest
from pinwm_drake.experiments.reproduce.scenes import task_scene
from pinwm_drake.experiments.reproduce.tables.table import MISSING, Results, Row, Table
from pinwm_drake.experiments.reproduce.twins import CaptureCell, SurfelsCell, TwinCell

_UNKNOWNS = ("friction_floor", "mass", "restitution_floor")
_FORCES = "mass"  # what a capture with forces is for; all that is looked for by default is looked for beside it
# Of the paper's table of identified parameters, for its push (Li et al., arXiv 2504.16693v2).
_PAPER = {("push", "friction_floor"): "0.0305", ("push", "mass"): "0.76 kg"}


def _cells(request: ReproduceRequest) -> list[TwinCell]:
    cells = []
    for task in request.tasks:
        seeds = range(request.seeds)
        cells += [TwinCell(request.twin(task, seed).surfels, only=name) for name in _UNKNOWNS for seed in seeds]
        cells += [TwinCell(SurfelsCell(CaptureCell(task, seed, request.quick, forces=True))) for seed in seeds]
    return cells


def _all(request: ReproduceRequest) -> list[Cell]:
    return list(_cells(request))


def _rows(request: ReproduceRequest, results: Results) -> list[Row]:
    rows: list[Row] = []
    for cell in _cells(request):
        task, done = cell.surfels.capture.task, results.get(cell)
        name, label = cell.only or _FORCES, cell.only or f"{_FORCES}, with the force on the pusher"
        true = task_scene(task).true_theta[name]
        paper = _PAPER.get((task, name), "not at hand")
        head = [task, label, cell.system, str(cell.surfels.capture.seed), f"{true:g}"]
        if done is None:
            rows.append([*head, MISSING, "", "", paper])
            continue
        estimate = done["result"]["estimates"][name]
        low, high = estimate["interval"] or ("", "")
        interval = f"{low:.4g} to {high:.4g}" if estimate["interval"] else "none"
        rows.append([*head, f"{estimate['value']:.4g}", interval, "yes" if estimate["identifiable"] else "no", paper])
    return rows


PARAMETERS = Table(
    "parameters",
    "Parameters",
    ("task", "unknown", "system", "seed", "true", "identified", "95 % interval", "identifiable", "paper"),
    _all,
    _rows,
    "Each unknown is looked for alone, with the nuisances of a video; the others have their true values. Motion alone "
    "does not tell the mass: a pusher that is driven by velocity moves any mass alike, and what comes out is a guess. "
    "With the force on the pusher, the mass is found beside all that is looked for by default.",
)
