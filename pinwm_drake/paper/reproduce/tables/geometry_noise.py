"""Table of geometry noise: one-step errors of twins whose mesh is known with an error only."""

from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.paper.reproduce.predictions import OneStepCell
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.tables import paper
from pinwm_drake.paper.reproduce.tables.one_step import PARTS, error_words
from pinwm_drake.paper.reproduce.tables.table import MISSING, Results, Row, Table
from pinwm_drake.paper.reproduce.twins import CaptureCell, NoisyCaptureCell, SurfelsCell, TwinCell

_SHARES = (0.0, 0.005, 0.01, 0.03)
# The mug has too many vertices for its outlines, and the convex pieces of one with noise take 3 to 12 minutes.
_SIMPLE = "push"


def _cells(request: ReproduceRequest) -> list[tuple[str, OneStepCell]]:
    found = []
    for task in request.tasks:
        kinds = [(share, False) for share in _SHARES if not share or task == _SIMPLE or not request.quick]
        kinds += [(share, True) for share in _SHARES if share and task == _SIMPLE]
        for share, refined in kinds:
            words = f"{100.0 * share:g} %" + (", mesh fitted to the masks" if refined else "")
            for seed in range(request.seeds):
                capture = CaptureCell(task, seed, request.quick)
                known = NoisyCaptureCell(capture, share, refined) if share else capture
                twin = TwinCell(SurfelsCell(known))
                found.append((words, OneStepCell(twin.system, request.outcomes(task), twin, curve=not share)))
    return found


def _all(request: ReproduceRequest) -> list[Cell]:
    return [cell for _, cell in _cells(request)]


def _rows(request: ReproduceRequest, results: Results) -> list[Row]:
    rows: list[Row] = []
    for kind, cell in _cells(request):
        done = results.get(cell)
        words = [MISSING, ""] if done is None else [error_words(done["result"][part], unit) for part, unit in PARTS]
        assert cell.twin is not None
        seed = str(cell.twin.surfels.capture.seed)
        task = cell.outcomes.task
        rows.append([task, cell.origin, kind, seed, *words, paper.NOISE.get((task, kind), paper.NONE)])
    return rows


GEOMETRY_NOISE = Table(
    "geometry-noise",
    "Geometry noise",
    ("task", "twin", "sigma by the diagonal", "seed", "translation", "rotation", "paper"),
    _all,
    _rows,
    "Vertices of the mesh that twins are made with are moved by normal noise; images, and the plant that they are "
    "compared with, are of the true object. Where it is said so, the mesh is then fitted to the masks of the static "
    "views (`pinwm capture refine`).",
)
