# SPDX-License-Identifier: MIT
"""`pinwm capture import`: a line on what was imported. The work is in `pinwm_drake.capture.importers`."""

from pathlib import Path

import typer

from pinwm_drake.cli.command import add_command
from pinwm_drake.cli.console import say
from pinwm_drake.experiments.requests.captures import ColmapRequest, NerfstudioRequest, PinwmRequest

import_app = typer.Typer(name="import", help="Make a capture of data in another format.", no_args_is_help=True)


def nerfstudio(request: NerfstudioRequest) -> None:
    """Make a capture of posed images in nerfstudio's or NeRF's layout."""
    from pinwm_drake.capture.importers.nerfstudio import import_nerfstudio

    views = import_nerfstudio(request.source, request.out, request.scenery.read(), request.world.read())
    _report(request.out, f"{views} static views")


def colmap(request: ColmapRequest) -> None:
    """Make a capture of a COLMAP model with PINHOLE or SIMPLE_PINHOLE cameras, and its images."""
    from pinwm_drake.capture.importers.colmap import import_colmap

    scenery, similarity = request.scenery.read(), request.world.read()
    views = import_colmap(request.source, request.out, scenery, similarity, images=request.images, masks=request.masks)
    _report(request.out, f"{views} static views")


def pinwm(request: PinwmRequest) -> None:
    """Make a capture of a data set in the layout of PIN-WM's authors."""
    from pinwm_drake.capture.importers.pinwm import import_pinwm

    files = import_pinwm(
        request.source,
        request.out,
        request.scenery.read(),
        pusher_height=request.pusher_height,
        camera=request.camera,
        static=request.static,
    )
    _report(request.out, ", ".join(f"episode {k:04} from {file}" for k, file in enumerate(files)))


def _report(out: Path, contents: str) -> None:
    say(f"wrote {out}: {contents}")
    say(f"check it with: pinwm capture check {out}")


add_command(
    import_app,
    NerfstudioRequest,
    nerfstudio,
    name="nerfstudio",
    example="pinwm capture import nerfstudio scan mycapture --mesh mug.obj",
)
add_command(
    import_app,
    ColmapRequest,
    colmap,
    name="colmap",
    example="pinwm capture import colmap scan mycapture --mesh mug.obj --transform world.yaml",
)
add_command(
    import_app,
    PinwmRequest,
    pinwm,
    name="pinwm",
    example="pinwm capture import pinwm sim_push_t mycapture --mesh cube_t.obj --pusher-mesh ee.obj",
)
