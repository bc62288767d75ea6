# SPDX-License-Identifier: MIT
"""Textured sheets in Meshcat."""

from collections.abc import Sequence

from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh, Meshcat, Rgba

from pinwm_drake.report.gltf import Sheet, gltf_text


def show_sheets(meshcat: Meshcat, path: str, sheets: Sequence[Sheet]) -> None:
    """Show sheets at a path in Meshcat's tree, in place of what is there."""
    file = MemoryFile(gltf_text(sheets), ".gltf", path)
    meshcat.SetObject(path, Mesh(InMemoryMesh(mesh_file=file)), Rgba(1, 1, 1, 1))
