"""`pinwm view`: its options. The work is in `view_show`."""

from pathlib import Path
from typing import Annotated

import typer


def view(
    splats: Annotated[
        Path,
        typer.Argument(metavar="SPLATS", help="A PLY file of surfels, a folder that holds surfels.ply, or a twin."),
    ],
    html: Annotated[Path | None, typer.Option(help="Write a web page of its own to this file, and end.")] = None,
    video: Annotated[Path | None, typer.Option(help="Write a turntable to this .mp4 file, and end.")] = None,
    size: Annotated[int, typer.Option(help="Width and height of the video, in px.")] = 480,
    seconds: Annotated[float, typer.Option(help="Length of the video, in s; one turn.")] = 4.0,
    host: Annotated[
        str, typer.Option(help="Address to listen on; others than this let other machines in.")
    ] = "127.0.0.1",
    port: Annotated[int | None, typer.Option(help="Port to listen on.", show_default="first free from 7000")] = None,
    browser: Annotated[bool, typer.Option("--browser", help="Open the page in a browser, too.")] = False,
) -> None:
    """Shows surfels in the browser (meshcat) until Ctrl-C, or writes them as a web page or a turntable video.

    Of a twin, the browser also shows the mesh of the object and the pusher beside it. Drake is not needed.
    """
    from pinwm_drake.cli.view_show import ViewOptions, run_view

    options = ViewOptions(html=html, video=video, size=size, seconds=seconds, host=host, port=port, browser=browser)
    run_view(splats, options)
