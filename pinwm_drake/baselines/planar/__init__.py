"""Identification in the plane: a differentiable simulator of sliding cells, and the twin that its finds make.

Source: Song and Boularias, "Learning to slide unknown objects with differentiable physics simulations" (RSS 2020).
"""

from pinwm_drake.baselines.planar.body import PlanarBody, make_planar_body
from pinwm_drake.baselines.planar.identify import PlanarOptions, PlanarProperties, PlanarResult, identify_planar
from pinwm_drake.baselines.planar.twin import planar_twin

__all__ = [
    "PlanarBody",
    "PlanarOptions",
    "PlanarProperties",
    "PlanarResult",
    "identify_planar",
    "make_planar_body",
    "planar_twin",
]
