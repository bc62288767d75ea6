"""Table of parameters: one physical unknown is identified at a time, while the others have their true values."""

from collections.abc import Sequence

from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import ASID, ASID_GENEROUS, PIN_WM, PLANAR, task_scene
from pinwm_drake.paper.reproduce.tables import paper
from pinwm_drake.paper.reproduce.tables.table import MISSING, NONE, Line, Results, Table
from pinwm_drake.paper.reproduce.twins import (
    CaptureCell,
    IdentifiedCell,
    SurfelsCell,
    TrackedTwinCell,
    TwinCell,
    twin_cell,
)

_UNKNOWNS = ("friction_floor", "mass", "restitution_floor")
_FORCES = "mass"  # what a capture with forces is for
_PLANAR_UNKNOWN = "friction_floor"  # of 2D Physics; its mass is held, and it knows no restitution
BESIDE = ", beside all that is looked for by default"


def unknown(cell: IdentifiedCell) -> tuple[str, str]:
    """Name of the parameter that a twin of this table is for, and the words for it."""
    if cell.only:
        return cell.only, cell.only
    if cell.system == PLANAR:
        return _PLANAR_UNKNOWN, f"{_PLANAR_UNKNOWN}{BESIDE}"
    return _FORCES, f"{_FORCES}, with the force on the pusher{BESIDE}"


def _cells(request: ReproduceRequest) -> list[IdentifiedCell]:
    found: list[IdentifiedCell] = []
    for task in request.tasks:
        seeds = range(request.seeds)
        for name in _UNKNOWNS:
            for system in request.chosen((PIN_WM, ASID, ASID_GENEROUS)):
                found += [twin_cell(request, task, seed, system, name) for seed in seeds]
            if name == _PLANAR_UNKNOWN and request.chosen((PLANAR,)):
                found += [twin_cell(request, task, seed, PLANAR) for seed in seeds]
        if request.chosen((PIN_WM,)):
            forced = [SurfelsCell(CaptureCell(task, seed, request.quick, forces=True)) for seed in seeds]
            found += [TwinCell(one) for one in forced]
    return found


def _lines(request: ReproduceRequest) -> list[Line]:
    lines = []
    for cell in _cells(request):
        (name, words), task = unknown(cell), cell.surfels.capture.task
        head = [task, words, cell.system, str(cell.surfels.capture.seed)]
        lines.append(Line(head, [cell], [paper.PARAMETERS.get((task, cell.system, name), NONE)]))
    return lines


def _columns(cells: Sequence[IdentifiedCell], results: Results) -> list[str]:
    (cell,) = cells
    (name, _), done = unknown(cell), results.get(cell)
    true = f"{task_scene(cell.surfels.capture.task).true_theta[name]:g}"
    if done is None:
        return [true, MISSING, "", ""]
    estimate = done["result"]["estimates"][name]
    low, high = estimate["interval"] or ("", "")
    interval = f"{low:.4g} to {high:.4g}" if estimate["interval"] else "none"
    told = "not told" if isinstance(cell, TrackedTwinCell) else "yes" if estimate["identifiable"] else "no"
    return [true, f"{estimate['value']:.4g}", interval, told]


PARAMETERS = Table(
    "parameters",
    "Parameters",
    ("task", "unknown", "system", "seed", "true", "identified", "95 % interval", "identifiable", "paper"),
    _lines,
    _columns,
    "Each unknown is looked for alone, by PIN-WM with the nuisances of a video; the others, inertia included, have "
    "their true values. Motion alone tells no more than the ratio of mass and inertia: a pusher that is driven by "
    "velocity moves an object of twice both alike. A mass that is looked for beside the inertia, as the 0.76 kg for 1 "
    "kg of the paper, is a guess; the force on the pusher tells it. 2D Physics holds the mass, and has no restitution.",
)
