# SPDX-License-Identifier: MIT
"""Shapes, meshes, convex pieces and the narrow phase that selects contact features."""
