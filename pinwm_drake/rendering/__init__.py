# SPDX-License-Identifier: MIT
"""2D Gaussian Splatting on the CPU: cameras, surfels, a differentiable rasteriser, and fitting from posed images."""
