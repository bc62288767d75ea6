"""The twin format: one object with its physical parameters and its appearance, read, checked and written."""

from pinwm_drake.twin.read import read_twin
from pinwm_drake.twin.twin import SURFELS_FILE, THETA, TWIN_FILE, Estimate, Twin
from pinwm_drake.twin.write import write_twin

__all__ = ["SURFELS_FILE", "THETA", "TWIN_FILE", "Estimate", "Twin", "read_twin", "write_twin"]
