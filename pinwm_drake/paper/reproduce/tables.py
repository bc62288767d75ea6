# SPDX-License-Identifier: MIT
"""The paper's tables, as cells that are needed and rows that are read from them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

from pinwm_drake.paper.reproduce import paper
from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.paper.reproduce.policies import EvaluationCell, dreamer, evaluated
from pinwm_drake.paper.reproduce.predictions import ImaginedStepCell, OneStepCell, SeenOutcomesCell, outcomes_cell
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import (
    ASID,
    ASID_GENEROUS,
    DREAMER,
    NO_COUSINS,
    PIN_WM,
    PLANAR,
    SCENE,
    SYSTEMS,
    task_scene,
)
from pinwm_drake.paper.reproduce.twins import (
    CaptureCell,
    IdentifiedCell,
    NoisyCaptureCell,
    SurfelsCell,
    TrackedTwinCell,
    TwinCell,
    twin_cell,
)

Results = Mapping[Cell, Mapping[str, Any] | None]
"""Done cells of a table by cell, as `CellStore.read` gives them; None where one is missing."""
Row = Sequence[str]
MISSING = "not run"
NONE = "none"  # where there is no such figure


class Line(NamedTuple):
    """Row of a table, and the cells that it is read from.

    Attributes:
        head: Its first columns.
        cells: Cells of the columns between; None where there is none.
        tail: Its last columns.
    """

    head: Row
    cells: Sequence[Cell | None]
    tail: Row


@dataclass(frozen=True)
class Table:
    """A table of the paper.

    Attributes:
        columns: Columns of the cells of a line, by the results; a missing one is "not run".
        words: Explanation of what is compared, for the report.
    """

    name: str
    title: str
    header: Row
    lines: Callable[[ReproduceRequest], list[Line]]
    columns: Callable[[Sequence[Any], Results], list[str]]
    words: str

    def cells(self, request: ReproduceRequest) -> list[Cell]:
        """Cells that the rows are read from, for a request; what these need is not among them."""
        return [cell for line in self.lines(request) for cell in line.cells if cell is not None]

    def rows(self, request: ReproduceRequest, results: Results) -> list[Row]:
        """Rows for a request and the results of its cells."""
        return [[*head, *self.columns(cells, results), *tail] for head, cells, tail in self.lines(request)]


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
    "Success in Drake's hydroelastic plant with VTK's images. No system is trained in worlds of this plant. Terms are "
    "not equal. `diffusion-policy` imitates demonstrations from this plant, and `dreamer-v2` learns from random pushes "
    "in it. `asid` uses the recorded push, not one by its own exploration policy. `domain-rand` systems see four past "
    "states and actions. `mpc` sees the true state.",
)
RANDOMIZATION = Table(
    "randomization",
    "Randomization",
    _HEADER,
    partial(_lines, _RANDOMIZED, paper.POLICIES),
    _columns,
    "Training with the true theta, in cousins of the twin, and with theta from ever wider ranges R.",
)
TASKS_TABLE = Table(
    "tasks",
    "Tasks",
    _HEADER,
    _of_objects,
    _columns,
    "T-block, cube and larger T-block are pushed on a slippery floor (friction 0.03). The cube is flipped on a rough "
    "floor (friction 0.2). The paper's figures are from a real robot.",
)
STAND_IN = Table(
    "stand-in",
    "Stand-in for a robot",
    _HEADER,
    _in_stand_in,
    _columns,
    "No real robot is used. The stand-in is the plant of the other tables; its object has a lump inside and feet "
    "below. Its camera is 3 mm and 0.5 degrees off, its actions are 80 ms late, masks are ragged, and one lamp "
    "shines. All systems are trained with actions 70 to 90 ms late. 20 trials on one station. Terms are not equal: "
    "`pin-wm` and `pin-wm-0` know the camera from the film of the push; the others use its nominal pose. Latency, "
    "poke and masks were chosen on this station. `mpc` sees the true state. The paper's figures are from a real "
    "robot.",
)


_SYSTEMS = (PIN_WM, ASID, ASID_GENEROUS, PLANAR, DREAMER)
_READOUT = "readout of true images: what reading a pose adds"
_ENGINES = "the scene's own theta: the engines' difference"


def _error_lines(request: ReproduceRequest) -> list[Line]:
    """Lines with the cell of the action's end and that of the object at rest; what is read from images has no second.

    The scene's own theta is always there.
    """
    found: list[Line] = []
    for task in request.tasks:
        outcomes, names = outcomes_cell(request, task), request.chosen(_SYSTEMS)
        at_rest = outcomes_cell(request, task, at_rest=True)

        def add(name: str, seed: str, cell: Cell, resting: Cell | None, task: str = task) -> None:
            tail = (str(request.draws), paper.ONE_STEP.get((task, name), NONE))
            found.append(Line((task, name, seed), (cell, resting), tail))

        for name in names:
            for seed in range(request.seeds):
                if name == DREAMER:
                    seen = SeenOutcomesCell(outcomes)
                    add(name, str(seed), ImaginedStepCell(seen, dreamer(task, seed, request.quick)), None)
                    continue
                twin = twin_cell(request, task, seed, name)
                step = OneStepCell(name, outcomes, twin, curve=name == PIN_WM)
                add(name, str(seed), step, OneStepCell(name, at_rest, twin))
        if DREAMER in names:
            add(_READOUT, "", SeenOutcomesCell(outcomes), None)
        add(_ENGINES, "", OneStepCell(SCENE, outcomes, None), OneStepCell(SCENE, at_rest, None))
    return found


def error_columns(cells: Sequence[Cell | None], results: Results) -> list[str]:
    """Two columns for each cell: mean, median and 95th percentile of translation [mm] and rotation [rad] errors."""
    words: list[str] = []
    for cell in cells:
        if cell is None:
            words += [NONE, NONE]
        elif (done := results.get(cell)) is None:
            words += [MISSING, ""]
        else:
            for part, unit, scale in (("translation", "mm", 1e3), ("rotation", "rad", 1.0)):
                values = (scale * done["result"][part][name] for name in ("mean", "median", "high"))
                words.append("{:.3g} {unit} (median {:.3g}, 95 % below {:.3g})".format(*values, unit=unit))
    return words


ONE_STEP = Table(
    "one-step",
    "One-step errors",
    (
        *("task", "prediction", "seed", "translation", "rotation", "translation at rest", "rotation at rest"),
        *("draws", "paper"),
    ),
    _error_lines,
    error_columns,
    "Error of the predicted object pose after one action, against Drake's hydroelastic plant. The action is as long as "
    "a policy's and leads towards a random point of the object. The first two columns are at the end of the action, "
    'while the object still moves. The columns "at rest" are after it has stopped, at most 2 s later. Dreamer V2 '
    'predicts images; the rendering loss reads the pose from them. The row "readout of true images" is the error of '
    'that reading. The row "the scene\'s own theta" is the difference between the two engines.',
)


_SHARES = (0.0, 0.005, 0.01, 0.03)
# The mug has too many vertices for its outlines, and the convex pieces of one with noise take 3 to 12 minutes.
_SIMPLE = "push"


def _noise_lines(request: ReproduceRequest) -> list[Line]:
    found = []
    for task in request.tasks:
        kinds = [(share, False) for share in _SHARES if not share or task == _SIMPLE or not request.quick]
        kinds += [(share, True) for share in _SHARES if share and task == _SIMPLE]
        for share, refined in kinds:
            words = f"{100.0 * share:g} %" + (", mesh fitted to the masks" if refined else "")
            for seed in range(request.seeds):
                capture = CaptureCell(task, seed, request.quick)
                twin = TwinCell(SurfelsCell(NoisyCaptureCell(capture, share, refined) if share else capture))
                cell = OneStepCell(twin.system, outcomes_cell(request, task), twin, curve=not share)
                tail = [paper.NOISE.get((task, words), NONE)]
                found.append(Line([task, cell.origin, words, str(seed)], [cell], tail))
    return found


GEOMETRY_NOISE = Table(
    "geometry-noise",
    "Geometry noise",
    ("task", "twin", "sigma by the diagonal", "seed", "translation", "rotation", "paper"),
    _noise_lines,
    error_columns,
    "Twins are made with a wrong mesh: normal noise moves its vertices. Images and plant have the true object. In rows "
    '"mesh fitted to the masks", `pinwm capture refine` has fitted the mesh to the masks of the static views. These '
    "errors are those of predicted poses. They do not show that theta is right: a twin with a fitted mesh can have a "
    "wrong friction.",
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


def _parameter_cells(request: ReproduceRequest) -> list[IdentifiedCell]:
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


def _parameter_lines(request: ReproduceRequest) -> list[Line]:
    lines = []
    for cell in _parameter_cells(request):
        (name, words), task = unknown(cell), cell.surfels.capture.task
        head = [task, words, cell.system, str(cell.surfels.capture.seed)]
        lines.append(Line(head, [cell], [paper.PARAMETERS.get((task, cell.system, name), NONE)]))
    return lines


def _parameter_columns(cells: Sequence[IdentifiedCell], results: Results) -> list[str]:
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
    _parameter_lines,
    _parameter_columns,
    "One unknown is identified at a time; the others, inertia included, have their true values. PIN-WM also fits the "
    "nuisances of a video. A pusher driven by velocity moves an object of twice the mass and inertia alike, so motion "
    "shows only their ratio. The paper's 0.76 kg for 1 kg, identified beside the inertia, is therefore a guess. The "
    "measured force on the pusher shows the mass. 2D Physics holds the mass and has no restitution.",
)
