"""`pinwm view`: a page, a video, or a server. Drake is not needed."""

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from pinwm_drake.cli.console import LOOPBACK, say, stages_bar
from pinwm_drake.errors import InputError, require
from pinwm_drake.files import prepare_folder

if TYPE_CHECKING:
    from pinwm_drake.rendering.surfels import Surfels
    from pinwm_drake.report.surfels.live_view import Solid


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
    from pinwm_drake.rendering.ply import read_ply
    from pinwm_drake.report.surfels.page import write_surfel_page
    from pinwm_drake.report.surfels.turntable import FRAME_RATE, write_turntable
    from pinwm_drake.twin.read import read_twin
    from pinwm_drake.twin.twin import SURFELS_FILE, TWIN_FILE

    for name, target, suffixes in (("--html", html, (".html", ".htm")), ("--video", video, (".mp4",))):
        fits = target is None or target.suffix.lower() in suffixes
        require(name, target, fits, f"a name that ends in {' or '.join(suffixes)}")
    require("--size", size, 16 <= size <= 4096 and size % 2 == 0, "an even number from 16 to 4096 px")
    require("--seconds", seconds, 0.1 <= seconds <= 600, "0.1 to 600 s")
    require("--port", port, port is None or 1 <= port <= 65535, "1 to 65535")
    path = splats / SURFELS_FILE if splats.is_dir() else splats
    twin = read_twin(splats) if (splats / TWIN_FILE).is_file() else None
    for target in (html, video):
        if target is not None:
            prepare_folder(target.parent)
            if target.is_dir():
                raise InputError(target, value="a folder", allowed="a file")
    surfels = read_ply(path) if twin is None else twin.surfels
    if html is not None:
        write_surfel_page(html, surfels, title=path.name)
        say(f"wrote {html}")
    if video is not None:
        frames = max(round(seconds * FRAME_RATE), 2)
        with stages_bar() as show:
            write_turntable(
                video, surfels, size=size, num_frames=frames, report=lambda share: show("turntable", share, "")
            )
        say(f"wrote {video}")
    if html is None and video is None:
        from pinwm_drake.report.surfels.live_view import twin_solids

        solids = [] if twin is None else twin_solids(twin)
        _serve(surfels, path if twin is None else splats, solids, host, port, browser)


def _serve(surfels: "Surfels", path: Path, solids: "list[Solid]", host: str, port: int | None, browser: bool) -> None:
    """Serves a page of surfels until Ctrl-C."""
    from pinwm_drake.report.surfels.live_view import serve_surfels

    also = "".join(f", {solid.name}" for solid in solids)

    def announce(url: str) -> None:
        say(f"{path}: {surfels.num_surfels} surfels{also} at {url}")
        if not host.startswith(LOOPBACK):
            Console().print(f"[yellow]Other machines can open it too, as it listens on {host}.[/]")
        say("Ctrl-C ends.")
        if browser:
            webbrowser.open(url)

    serve_surfels(surfels, solids=solids, host=host, port=port, ready=announce)
