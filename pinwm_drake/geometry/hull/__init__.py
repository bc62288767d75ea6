# SPDX-License-Identifier: MIT
"""Surfaces from pictures and files: the visual hull, depths fused in it, and repair of meshes."""
