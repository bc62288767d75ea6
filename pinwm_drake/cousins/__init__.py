"""Digital cousins of a twin: copies whose physical parameters and colours are a little different."""

from pinwm_drake.cousins.cousin import Cousin, CousinDraw, Cousins, draw_cousins
from pinwm_drake.cousins.domain import CousinDomains, Domain, DomainDraw, DomainSource
from pinwm_drake.cousins.io import read_cousins, write_cousins
from pinwm_drake.cousins.randomization import FLIP_SPANS, RandomDomains, Spans
from pinwm_drake.cousins.ranges import Range

__all__ = [
    "FLIP_SPANS",
    "Cousin",
    "CousinDomains",
    "CousinDraw",
    "Cousins",
    "Domain",
    "DomainDraw",
    "DomainSource",
    "RandomDomains",
    "Range",
    "Spans",
    "draw_cousins",
    "read_cousins",
    "write_cousins",
]
