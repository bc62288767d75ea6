# SPDX-License-Identifier: MIT
"""`pinwm mesh`: what was made of which source, and what is doubtful."""

from pinwm_drake.cli.console import say
from pinwm_drake.experiments.requests.lab import MeshRequest

_KINDS = {"file": "the file", "depths": "depths within the hull of the masks", "hull": "the hull of the masks"}


def mesh(request: MeshRequest) -> None:
    """Make a closed mesh of the object, in metres.

    A CAD file or scan is repaired and scaled; else depths are fused; else the masks' hull is taken.
    """
    from pinwm_drake.experiments.meshing import make_mesh

    found = make_mesh(request.folder, source=request.source, out=request.out, replace=request.replace)
    size = " x ".join(f"{1e3 * x:.1f}" for x in found.mesh.extents)
    say(f"{_KINDS[found.kind]}: {len(found.mesh.faces)} triangles, {size} mm, {1e6 * found.mesh.volume:.1f} cm³")
    for words in found.done:
        say(words)
    if found.pose is not None:
        say(f"outlines of the mesh and masks differ by {100 * found.pose.differing:.1f} % of the object")
    for words in found.warnings:
        say(f"doubtful: {words}", style="yellow")
    say(f"wrote {found.path}; then: pinwm pose {request.folder}")
