"""Table of geometry noise: one-step errors of twins whose mesh is known with an error only."""

from pinwm_drake.paper.reproduce.predictions import OneStepCell
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.tables import paper
from pinwm_drake.paper.reproduce.tables.one_step import error_columns
from pinwm_drake.paper.reproduce.tables.table import NONE, Line, Table
from pinwm_drake.paper.reproduce.twins import CaptureCell, NoisyCaptureCell, SurfelsCell, TwinCell

_SHARES = (0.0, 0.005, 0.01, 0.03)
# The mug has too many vertices for its outlines, and the convex pieces of one with noise take 3 to 12 minutes.
_SIMPLE = "push"


def _lines(request: ReproduceRequest) -> list[Line]:
    found = []
    for task in request.tasks:
        kinds = [(share, False) for share in _SHARES if not share or task == _SIMPLE or not request.quick]
        kinds += [(share, True) for share in _SHARES if share and task == _SIMPLE]
        for share, refined in kinds:
            words = f"{100.0 * share:g} %" + (", mesh fitted to the masks" if refined else "")
            for seed in range(request.seeds):
                capture = CaptureCell(task, seed, request.quick)
                twin = TwinCell(SurfelsCell(NoisyCaptureCell(capture, share, refined) if share else capture))
                cell = OneStepCell(twin.system, request.outcomes(task), twin, curve=not share)
                tail = [paper.NOISE.get((task, words), NONE)]
                found.append(Line([task, cell.origin, words, str(seed)], [cell], tail))
    return found


GEOMETRY_NOISE = Table(
    "geometry-noise",
    "Geometry noise",
    ("task", "twin", "sigma by the diagonal", "seed", "translation", "rotation", "paper"),
    _lines,
    error_columns,
    "Vertices of the mesh that twins are made with are moved by normal noise; images, and the plant that they are "
    "compared with, are of the true object. Where it is said so, the mesh is then fitted to the masks of the static "
    "views (`pinwm capture refine`).",
)
