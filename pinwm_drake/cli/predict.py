"""`pinwm predict`: its options. The work is in `predict_run`."""

from pathlib import Path
from typing import Annotated

import typer


def predict(
    twin: Annotated[Path, typer.Argument(metavar="TWIN", help="Folder that `pinwm identify` wrote.")],
    episode: Annotated[
        Path, typer.Argument(metavar="EPISODE", help="CAPTURE/episodes/NAME, of this capture or another one.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="File of the poses, as object_poses.csv has them.")],
    video: Annotated[
        Path | None, typer.Option(help="Film camera, twin and difference side by side to this .mp4 file.")
    ] = None,
) -> None:
    """Rolls a twin out along an episode's pusher log; with object_poses.csv there, says how far off it is."""
    from pinwm_drake.cli.predict_run import run_predict

    run_predict(twin, episode, out, video)
