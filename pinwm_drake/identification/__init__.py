"""Identification: the physical parameters of an object from the video of one push."""

from pinwm_drake.identification.identify import Identification, identify
from pinwm_drake.identification.options import IdentifyOptions

__all__ = ["Identification", "IdentifyOptions", "identify"]
