"""`pinwm model`: its arguments. The work is in `model_run`."""

from pathlib import Path
from typing import Annotated

import typer


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
    from pinwm_drake.cli.model_run import run_model

    run_model(twin, out)
