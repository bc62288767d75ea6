"""Tables of one-step errors: how far a prediction is from the plant after one random action."""

from collections.abc import Sequence

from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.paper.reproduce.policies import dreamer
from pinwm_drake.paper.reproduce.predictions import ImaginedStepCell, OneStepCell, SeenOutcomesCell, outcomes_cell
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import ASID, ASID_GENEROUS, DREAMER, PIN_WM, PLANAR, SCENE
from pinwm_drake.paper.reproduce.tables import paper
from pinwm_drake.paper.reproduce.tables.table import MISSING, NONE, Line, Results, Table
from pinwm_drake.paper.reproduce.twins import CaptureCell, NoisyCaptureCell, SurfelsCell, TwinCell, twin_cell

_SYSTEMS = (PIN_WM, ASID, ASID_GENEROUS, PLANAR, DREAMER)
_READOUT = "readout of true images: what reading a pose adds"
_ENGINES = "the scene's own theta: the engines' difference"


def _lines(request: ReproduceRequest) -> list[Line]:
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
    _lines,
    error_columns,
    "Errors of the object's pose after one action towards a random point of the object, as long as those that policies "
    "take, against Drake's hydroelastic plant: when the action ends, while the object still moves, and when it rests, "
    "2 s later at the most. Dreamer V2 predicts images, from which poses are read by the rendering loss; the "
    "error of that alone is the row of the plant's own images.",
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
    "Vertices of the mesh that twins are made with are moved by normal noise; images, and the plant that they are "
    "compared with, are of the true object. Where it is said so, the mesh is then fitted to the masks of the static "
    "views (`pinwm capture refine`).",
)
