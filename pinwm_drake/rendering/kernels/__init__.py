"""The rasteriser's numba kernels: projection, bins, blending, and their adjoints."""
