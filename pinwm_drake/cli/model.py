"""`pinwm model`: a twin as SDFormat."""

from pathlib import Path
from typing import Annotated

import typer

from pinwm_drake.cli.console import say


def model(
    twin: Annotated[Path, typer.Argument(metavar="TWIN", help="Folder that `pinwm identify` wrote.")],
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="Folder for object.sdf, object_point.sdf, floor.sdf, pusher.sdf and their meshes."
        ),
    ],
) -> None:
    """Writes a twin as SDFormat models, which Drake's Parser loads."""
    from pinwm_drake.systems.sdf.twin import write_twin_model
    from pinwm_drake.twin.read import read_twin

    for path in write_twin_model(read_twin(twin), out):
        say(f"wrote {path}")
