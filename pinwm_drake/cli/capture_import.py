"""`pinwm capture import`: options of the importers. The work is in `pinwm_drake.capture.importers`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from pinwm_drake.capture.importers.similarity import Similarity
    from pinwm_drake.capture.importers.target import Scenery
    from pinwm_drake.capture.scene import PusherShape
    from pinwm_drake.spatial.poses import Pose

import_app = typer.Typer(name="import", help="Make a capture of data in another format.", no_args_is_help=True)

_Out = Annotated[Path, typer.Argument(metavar="OUT", help="The capture; a new or an empty folder.")]
_Mesh = Annotated[Path, typer.Option(help="The object's mesh, in metres, object frame O.")]
_Name = Annotated[str, typer.Option(help="The object's name.")]
_At = Annotated[
    str | None,
    typer.Option(help='Pose of the object in the world of the capture: "x y z qw qx qy qz", m.'),
]
_Mass = Annotated[
    float | None, typer.Option(help="The object's mass, in kg.", min=1e-6, max=1e4, show_default="not measured")
]
_PusherMesh = Annotated[Path | None, typer.Option(help="The pusher's mesh, in metres, pusher frame P.")]
_Shape = Annotated[
    str | None,
    typer.Option(help='The pusher as a shape: "sphere R", "capsule R LENGTH" or "cylinder R LENGTH", m.'),
]
_Floor = Annotated[float, typer.Option(help="Height of the floor, in m.", min=-100.0, max=100.0)]
_Gravity = Annotated[float, typer.Option(help="Gravity, in m/s^2.", min=1e-3, max=1e3)]
_Transform = Annotated[
    Path | None,
    typer.Option(help="YAML or JSON file with the 4 x 4 similarity from the source's world to the capture's."),
]
_Scale = Annotated[float, typer.Option(help="Metres for each unit of the source's world.")]


@import_app.command(epilog="Example: pinwm capture import nerfstudio scan mycapture --mesh mug.obj")
def nerfstudio(
    source: Annotated[Path, typer.Argument(metavar="SRC", help="The folder with transforms.json, or that file.")],
    out: _Out,
    mesh: _Mesh,
    name: _Name = "object",
    pose: _At = None,
    mass: _Mass = None,
    pusher_mesh: _PusherMesh = None,
    pusher_shape: _Shape = None,
    floor: _Floor = 0.0,
    gravity: _Gravity = 9.8,
    transform: _Transform = None,
    scale: _Scale = 1.0,
) -> None:
    """Makes a capture of posed images in nerfstudio's or NeRF's layout."""
    from pinwm_drake.capture.importers.nerfstudio import import_nerfstudio

    scenery = _scenery(mesh, name, pose, mass, pusher_mesh, pusher_shape, floor, gravity)
    views = import_nerfstudio(source, out, scenery, _similarity(transform, scale))
    _report(out, f"{views} static views")


@import_app.command(epilog="Example: pinwm capture import colmap scan mycapture --mesh mug.obj --transform world.yaml")
def colmap(
    source: Annotated[
        Path, typer.Argument(metavar="SRC", help="A model, text or binary; or a folder with it in sparse/0.")
    ],
    out: _Out,
    mesh: _Mesh,
    images: Annotated[Path | None, typer.Option(help="Folder of the images.", show_default="SRC/images")] = None,
    masks: Annotated[
        Path | None, typer.Option(help="Folder of masks NAME.png.", show_default="alpha or white background")
    ] = None,
    name: _Name = "object",
    pose: _At = None,
    mass: _Mass = None,
    pusher_mesh: _PusherMesh = None,
    pusher_shape: _Shape = None,
    floor: _Floor = 0.0,
    gravity: _Gravity = 9.8,
    transform: _Transform = None,
    scale: _Scale = 1.0,
) -> None:
    """Makes a capture of a COLMAP model with PINHOLE or SIMPLE_PINHOLE cameras, and its images."""
    from pinwm_drake.capture.importers.colmap import import_colmap

    scenery = _scenery(mesh, name, pose, mass, pusher_mesh, pusher_shape, floor, gravity)
    views = import_colmap(source, out, scenery, _similarity(transform, scale), images=images, masks=masks)
    _report(out, f"{views} static views")


@import_app.command(
    epilog="Example: pinwm capture import pinwm sim_push_t mycapture --mesh cube_t.obj --pusher-mesh ee.obj "
    "--pusher-height 0.05"
)
def pinwm(
    source: Annotated[Path, typer.Argument(metavar="SRC", help="The folder with dynamic_train0.json.")],
    out: _Out,
    mesh: _Mesh,
    pusher_mesh: _PusherMesh = None,
    pusher_shape: _Shape = None,
    pusher_height: Annotated[
        float | None,
        typer.Option(help="Height of the pusher, in m.", min=-100.0, max=100.0, show_default="that of the data"),
    ] = None,
    camera: Annotated[
        int | None, typer.Option(help="Number of the camera of the pushes.", show_default="the lowest")
    ] = None,
    static: Annotated[
        Path | None, typer.Option(help="File of the static views.", show_default="SRC/transforms_train.json")
    ] = None,
    name: _Name = "object",
    pose: _At = None,
    mass: _Mass = None,
    floor: _Floor = 0.0,
    gravity: _Gravity = 9.8,
) -> None:
    """Makes a capture of a data set in the layout of PIN-WM's authors."""
    from pinwm_drake.capture.importers.pinwm import import_pinwm
    from pinwm_drake.errors import ParameterError

    if pusher_mesh is None and pusher_shape is None:
        raise ParameterError("--pusher-mesh: got none; allowed: a mesh, or a --pusher-shape")
    scenery = _scenery(mesh, name, pose, mass, pusher_mesh, pusher_shape, floor, gravity)
    files = import_pinwm(source, out, scenery, pusher_height=pusher_height, camera=camera, static=static)
    _report(out, ", ".join(f"episode {k:04} from {file}" for k, file in enumerate(files)))


def _scenery(
    mesh: Path,
    name: str,
    pose: str | None,
    mass: float | None,
    pusher_mesh: Path | None,
    pusher_shape: str | None,
    floor: float,
    gravity: float,
) -> "Scenery":
    """Scenery that the options describe; raises ParameterError where one is out of range."""
    from pinwm_drake.capture.importers.target import Scenery

    shape = None if pusher_shape is None else _shape(pusher_shape)
    X_WO = None if pose is None else _pose(pose)
    return Scenery(name, mesh, X_WO, mass, pusher_mesh, shape, floor, gravity)


def _similarity(transform: Path | None, scale: float) -> "Similarity":
    from pinwm_drake.capture.importers.similarity import read_similarity, scaled_world
    from pinwm_drake.errors import ParameterError

    if not 1e-6 <= scale <= 1e6:
        raise ParameterError(f"--scale: got {scale:g}; allowed: 1e-06 to 1e+06 m for each unit")
    return scaled_world(scale) if transform is None else read_similarity(transform, scale)


def _pose(text: str) -> "Pose":
    import numpy as np
    import torch

    from pinwm_drake.errors import ParameterError
    from pinwm_drake.spatial.poses import Pose

    values = _numbers(text)
    if len(values) == 7:
        norm = float(np.linalg.norm(values[3:]))
        if abs(norm - 1) < 1e-3:
            return Pose(
                torch.tensor(values[3:], dtype=torch.float64) / norm, torch.tensor(values[:3], dtype=torch.float64)
            )
    raise ParameterError(f'--pose: got "{text}"; allowed: seven numbers "x y z qw qx qy qz", with a unit quaternion')


def _shape(text: str) -> "PusherShape":
    from pinwm_drake.capture.scene import PusherShape
    from pinwm_drake.errors import ParameterError

    kind, _, rest = text.strip().partition(" ")
    sizes = _numbers(rest)
    if all(1e-4 <= size <= 5.0 for size in sizes):
        if kind == "sphere" and len(sizes) == 1:
            return PusherShape("sphere", sizes[0])
        if (kind == "capsule" or kind == "cylinder") and len(sizes) == 2:
            return PusherShape("capsule" if kind == "capsule" else "cylinder", sizes[0], sizes[1])
    raise ParameterError(
        f'--pusher-shape: got "{text}"; allowed: "sphere R", "capsule R LENGTH" or "cylinder R LENGTH", 0.0001 to 5 m'
    )


def _numbers(text: str) -> list[float]:
    """Finite numbers in a text, with spaces or commas between them; an empty list where it has something else."""
    import math

    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        return []
    return values if all(math.isfinite(value) for value in values) else []


def _report(out: Path, contents: str) -> None:
    from rich.console import Console

    console = Console()
    console.print(f"wrote {out}: {contents}", highlight=False, markup=False, soft_wrap=True)
    console.print(f"check it with: pinwm capture check {out}", highlight=False, markup=False, soft_wrap=True)
