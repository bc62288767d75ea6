# SPDX-License-Identifier: MIT
"""`pinwm view`: a page, a video, or a server. Drake is not needed."""

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from pinwm_drake.cli.console import LOOPBACK, say, stages_bar
from pinwm_drake.experiments.requests.twins import ViewRequest

if TYPE_CHECKING:
    from pinwm_drake.rendering.surfels import Surfels
    from pinwm_drake.report.surfels.live_view import Solid


def view(request: ViewRequest) -> None:
    """Show surfels in a browser, or write a web page or a video.

    A twin is shown with the mesh of its object and its pusher. Drake is not needed.
    """
    from pinwm_drake.files import prepare_folder
    from pinwm_drake.models import twin_path
    from pinwm_drake.rendering.ply import read_ply
    from pinwm_drake.report.surfels.page import write_surfel_page
    from pinwm_drake.report.surfels.turntable import FRAME_RATE, write_turntable
    from pinwm_drake.twin.read import load_twin
    from pinwm_drake.twin.twin import SURFELS_FILE, TWIN_FILE

    splats, html, video = twin_path(request.splats), request.html, request.video
    path = splats / SURFELS_FILE if splats.is_dir() else splats
    twin = load_twin(splats) if (splats / TWIN_FILE).is_file() else None
    for target in (html, video):
        if target is not None:
            prepare_folder(target.parent)
    surfels = read_ply(path) if twin is None else twin.surfels
    if html is not None:
        write_surfel_page(html, surfels, title=path.name if twin is None else twin.name)
        say(f"wrote {html}")
    if video is not None:
        frames = max(round(request.seconds * FRAME_RATE), 2)
        with stages_bar() as show:
            write_turntable(
                video, surfels, size=request.size, num_frames=frames, report=lambda share: show("turntable", share, "")
            )
        say(f"wrote {video}")
    if html is None and video is None:
        from pinwm_drake.report.surfels.live_view import twin_solids

        solids = [] if twin is None else twin_solids(twin)
        place = path if twin is None else splats
        _serve(surfels, place, solids, request.host, request.port, request.browser)


def _serve(surfels: "Surfels", path: Path, solids: "list[Solid]", host: str, port: int | None, browser: bool) -> None:
    """Serve a page of surfels until Ctrl-C."""
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
