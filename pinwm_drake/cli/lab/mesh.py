# SPDX-License-Identifier: MIT
"""`pinwm mesh`: what was made of which source, and what is doubtful."""

from pinwm_drake.cli.console import say
from pinwm_drake.experiments.requests.lab import MeshRequest


def mesh(request: MeshRequest) -> None:
    """Make a closed mesh of the object, in metres.

    A CAD file or scan is repaired and scaled; else depths are fused; else the masks' hull is taken.
    """
    from pinwm_drake.experiments.meshing import make_mesh, write_mesh_error

    found = make_mesh(request.folder, source=request.source, out=request.out, replace=request.replace)
    for line in found.words():
        say(line, style="yellow" if line.startswith("doubtful") else None)
    for line in write_mesh_error(request.folder, found.kind) if request.out is None else []:
        say(line, style="yellow")
    say(f"wrote {found.path}; then: pinwm pose {request.folder}")
