# SPDX-License-Identifier: MIT
"""The numba kernels: the rasteriser's projection, bins and blending with their adjoints; SSIM; outlines of meshes."""
