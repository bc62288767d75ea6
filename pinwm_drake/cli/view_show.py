"""What `pinwm view` does: a page, a video, or a server. Drake is not needed."""

import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.progress import track

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import prepare_folder
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.ply import read_ply
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.surfels.page import write_surfel_page
from pinwm_drake.report.surfels.turntable import turntable
from pinwm_drake.report.video import write_video
from pinwm_drake.twin import SURFELS_FILE, TWIN_FILE, Twin, read_twin

if TYPE_CHECKING:
    from pinwm_drake.report.surfels.live_view import Solid

__all__ = ["SURFELS_FILE", "ViewOptions", "run_view", "write_turntable"]

FRAME_RATE = 24  # of turntables [1/s]
_APART = 0.5  # of the pusher's size, between it and the object
_LOOPBACK = ("127.", "localhost", "::1")


@dataclass(frozen=True)
class ViewOptions:
    """Where and how surfels are shown.

    Attributes:
        html: File of the web page, or None.
        video: File of the turntable, or None.
        size: Width and height of the turntable [px], even.
        seconds: Its length [s].
        host: Address to listen on where neither file is wanted.
        port: Port to listen on, or None for a free one.
        browser: Whether to open a browser.
    """

    html: Path | None
    video: Path | None
    size: int
    seconds: float
    host: str
    port: int | None
    browser: bool

    def __post_init__(self) -> None:
        """Checks every option.

        Raises:
            ParameterError: One is outside its range, named as on the command line.
        """
        for name, path, suffixes in (("--html", self.html, (".html", ".htm")), ("--video", self.video, (".mp4",))):
            if path is not None and path.suffix.lower() not in suffixes:
                raise ParameterError(f"{name}: got {path}; allowed: a name that ends in {' or '.join(suffixes)}")
        if not 16 <= self.size <= 4096 or self.size % 2:
            raise ParameterError(f"--size: got {self.size}; allowed: an even number from 16 to 4096 px")
        if not 0.1 <= self.seconds <= 600:
            raise ParameterError(f"--seconds: got {self.seconds}; allowed: 0.1 to 600 s")
        if self.port is not None and not 1 <= self.port <= 65535:
            raise ParameterError(f"--port: got {self.port}; allowed: 1 to 65535")


def run_view(splats: Path, options: ViewOptions) -> None:
    """Shows surfels, and in the browser what else a twin has.

    Args:
        splats: A PLY file, a folder with `surfels.ply`, or the folder of a twin.
        options: Where and how.

    Raises:
        PinwmError: The surfels or the twin cannot be read, a file cannot be written, or the address is not to be had.
    """
    path = splats / SURFELS_FILE if splats.is_dir() else splats
    twin = read_twin(splats) if (splats / TWIN_FILE).is_file() else None
    for target in (options.html, options.video):
        if target is not None:
            prepare_folder(target.parent)
            if target.is_dir():
                raise InputError(target, value="a folder", allowed="a file")
    surfels = read_ply(path) if twin is None else twin.surfels
    console = Console()
    if options.html is not None:
        write_surfel_page(options.html, surfels, title=path.name)
        console.print(f"wrote {options.html}", highlight=False, soft_wrap=True)
    if options.video is not None:
        write_turntable(options.video, surfels, options.size, max(round(options.seconds * FRAME_RATE), 2), console)
        console.print(f"wrote {options.video}", highlight=False, soft_wrap=True)
    if options.html is None and options.video is None:
        _serve(surfels, path if twin is None else splats, [] if twin is None else _solids(twin), options, console)


def write_turntable(
    path: Path, surfels: Surfels, size: int, num_frames: int, console: Console, up: np.ndarray | None = None
) -> None:
    """Films one turn, with a progress bar.

    Args:
        path: An .mp4 file; its folder exists.
        surfels: The object.
        size: Width and height [px].
        num_frames: How many pictures.
        console: Where the bar shows.
        up: (3,), the axis that it turns about, object frame; None for z.

    Raises:
        InputError: The file cannot be written.
    """
    frames = turntable(surfels, size=size, num_frames=num_frames, up=up)
    shown = track(frames, "turntable", total=num_frames, console=console)
    write_video(path, shown, rate=FRAME_RATE, size=(size, size))


def _solids(twin: Twin) -> "list[Solid]":
    """The mesh of a twin's object, translucent, and its pusher, which stands beside it on the same level."""
    from pinwm_drake.report.surfels.live_view import Solid

    mesh, pusher = load_mesh(twin.mesh_path), pusher_surface(twin.pusher)
    (low, high), size = mesh.bounds, pusher.extents
    place = np.array([high[0] + _APART * size[0], 0.5 * (low[1] + high[1]), low[2]])
    pusher.apply_translation(place - [pusher.bounds[0, 0], pusher.bounds[:, 1].mean(), pusher.bounds[0, 2]])
    return [Solid("mesh", mesh, 0x808080, 0.25), Solid("pusher", pusher, 0x4A4A50, 1.0)]


def _serve(surfels: Surfels, path: Path, solids: "list[Solid]", options: ViewOptions, console: Console) -> None:
    """Listens until Ctrl-C."""
    from pinwm_drake.report.surfels.live_view import serve_surfels

    also = "".join(f", {solid.name}" for solid in solids)

    def announce(url: str) -> None:
        console.print(f"{path}: {surfels.num_surfels} surfels{also} at {url}", highlight=False, soft_wrap=True)
        if not options.host.startswith(_LOOPBACK):
            console.print(f"[yellow]Other machines can open it too, as it listens on {options.host}.[/]")
        console.print("Ctrl-C ends.")
        if options.browser:
            webbrowser.open(url)

    serve_surfels(surfels, solids=solids, host=options.host, port=options.port, ready=announce)
