# SPDX-License-Identifier: MIT
"""Requests of the commands of `pinwm capture` that read, import and refine captures."""

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pinwm_drake.errors import ParameterError, require
from pinwm_drake.request import DATA, FLATTEN, LAB, argument, option, request

if TYPE_CHECKING:
    from pinwm_drake.capture.importers.similarity import Similarity
    from pinwm_drake.capture.importers.target import Scenery
    from pinwm_drake.capture.scene import PusherShape
    from pinwm_drake.spatial.poses import Pose

_Folder = Annotated[Path, argument("Capture: a folder with capture.yaml.", "CAPTURE", completes="capture")]
_Out = Annotated[Path, argument("Folder of the new capture, new or empty.", "OUT", result="beside")]


@request
class CheckRequest:
    """Request of a check: what `pinwm capture check` does."""

    folder: _Folder
    every: Annotated[bool, option("Show every problem on a row of its own.", "--all")] = False


@request
class RefineRequest:
    """Request of a refinement: what `pinwm capture refine` does."""

    folder: _Folder
    out: Annotated[Path, argument("Folder of the copy; it must not be there yet.", "OUT", result="beside")]


@request
class SceneryOptions:
    """Options on object, pusher, floor and gravity, which every importer has."""

    mesh: Annotated[Path, option("Mesh of the object in metres, frame O.")]
    name: Annotated[str, option("Name of the object.", group=DATA)] = "object"
    pose: Annotated[
        str | None,
        option('Pose of the object in the capture\'s world: "x y z qw qx qy qz".', group=DATA, unit="m"),
    ] = None
    mass: Annotated[
        float | None, option("Mass of the object.", group=DATA, unit="kg", ge=1e-6, le=1e4, default="not measured")
    ] = None
    pusher_mesh: Annotated[Path | None, option("Mesh of the pusher in metres, frame P.", group=DATA)] = None
    pusher_shape: Annotated[
        str | None,
        option('Shape of the pusher: "sphere R", "capsule R LENGTH" or "cylinder R LENGTH".', group=DATA, unit="m"),
    ] = None
    floor: Annotated[float, option("Height of the floor.", group=LAB, unit="m", ge=-100, le=100)] = 0.0
    gravity: Annotated[float, option("Gravity, downwards.", group=LAB, unit="m/s^2", ge=1e-3, le=1e3)] = 9.8

    def read(self) -> "Scenery":
        """Scenery that the options describe; raises ParameterError where a text is no pose or shape."""
        from pinwm_drake.capture.importers.target import Scenery

        shape = None if self.pusher_shape is None else _shape(self.pusher_shape)
        X_WO = None if self.pose is None else _pose(self.pose)
        return Scenery(self.name, self.mesh, X_WO, self.mass, self.pusher_mesh, shape, self.floor, self.gravity)


@request
class WorldOptions:
    """Options on a source whose world has axes and units of its own."""

    transform: Annotated[
        Path | None,
        option("File of the 4 x 4 similarity from the source's world to the capture's.", group=LAB),
    ] = None
    scale: Annotated[
        float, option("Length of one unit of the source's world.", group=LAB, unit="m", ge=1e-6, le=1e6)
    ] = 1.0

    def read(self) -> "Similarity":
        """Similarity from the source's world to the capture's; raises InputError where its file cannot be read."""
        from pinwm_drake.capture.importers.similarity import read_similarity, scaled_world

        return scaled_world(self.scale) if self.transform is None else read_similarity(self.transform, self.scale)


@request
class NerfstudioRequest:
    """Request of an import: what `pinwm capture import nerfstudio` does."""

    source: Annotated[Path, argument("Folder with transforms.json, or that file.", "SRC")]
    out: _Out
    scenery: Annotated[SceneryOptions, FLATTEN]
    world: Annotated[WorldOptions, FLATTEN] = dataclasses.field(default_factory=WorldOptions)


@request
class ColmapRequest:
    """Request of an import: what `pinwm capture import colmap` does."""

    source: Annotated[Path, argument("COLMAP model, text or binary, or a folder with it in sparse/0.", "SRC")]
    out: _Out
    scenery: Annotated[SceneryOptions, FLATTEN]
    images: Annotated[Path | None, option("Folder of the images.", default="SRC/images", group=DATA)] = None
    masks: Annotated[
        Path | None, option("Folder of masks NAME.png.", group=DATA, default="SRC/masks, alpha, or white background")
    ] = None
    world: Annotated[WorldOptions, FLATTEN] = dataclasses.field(default_factory=WorldOptions)


@request
class PinwmRequest:
    """Request of an import: what `pinwm capture import pinwm` does."""

    source: Annotated[Path, argument("Folder with dynamic_train0.json.", "SRC")]
    out: _Out
    scenery: Annotated[SceneryOptions, FLATTEN]
    pusher_height: Annotated[
        float | None, option("Height of the pusher.", group=LAB, unit="m", ge=-100, le=100, default="that of the data")
    ] = None
    camera: Annotated[
        int | None, option("Number of the camera that filmed the pushes.", group=DATA, default="the lowest")
    ] = None
    static: Annotated[
        Path | None, option("File of the static views.", group=DATA, default="SRC/transforms_train.json")
    ] = None

    def __post_init__(self) -> None:
        """Check that there is a pusher."""
        known = self.scenery.pusher_mesh is not None or self.scenery.pusher_shape is not None
        require("--pusher-mesh", "none", known, "a mesh, or a --pusher-shape")


@request
class AddEpisodeRequest:
    """Request of a new episode: what `pinwm capture add-episode` does."""

    folder: _Folder
    video: Annotated[
        Path, option("Film: a video, a folder of images, rosbag2, MCAP, a LeRobot data set or an LCM log.")
    ]
    log: Annotated[
        Path | None, option("Log of the pusher: CSV, or one of the recordings.", default="that of --video")
    ] = None
    columns: Annotated[
        str,
        option(
            "Map of the log's columns: t=stamp[ms],px=x[mm],py=y[mm],pz=0.05[m].",
            metavar="MAP",
            default="guessed from the names of columns",
        ),
    ] = ""
    camera: Annotated[
        Path | None, option("Intrinsics and pose, as camera.json; or station.yaml.", default="that of the last episode")
    ] = None
    masks: Annotated[
        Path | None, option("Folder or film of masks, one for each frame.", group=DATA, default="alpha of the frames")
    ] = None
    name: Annotated[str | None, option("Name of the episode.", group=DATA, default="the next number")] = None
    rate: Annotated[
        float | None,
        option("Frames in a second, of a film without stamps.", group=DATA, unit="Hz", gt=0, le=10_000, default="none"),
    ] = None
    stamps: Annotated[
        Path | None, option("CSV file of the images' times.", group=DATA, default="stamps.csv beside them")
    ] = None
    topic: Annotated[
        str | None, option("Topic, camera or channel of the images.", group=DATA, default="the only one")
    ] = None
    log_topic: Annotated[
        str | None, option("Topics or channel of the log; TOPIC:FRAME in tf.", group=DATA, default="the only one")
    ] = None
    number: Annotated[int, option("Number of the episode in a LeRobot data set.", group=DATA, ge=0)] = 0
    start: Annotated[
        float | None, option("Time of the film from which it is used.", group=DATA, unit="s", ge=0, default="its start")
    ] = None
    end: Annotated[
        float | None, option("Time of the film up to which it is used.", group=DATA, unit="s", gt=0, default="its end")
    ] = None
    offset: Annotated[
        float | None, option("Log's time less the film's, roughly.", group=LAB, unit="s", default="found, 0 to 1.5 s")
    ] = None
    exact: Annotated[bool, option("Take --offset as it is.", group=LAB)] = False

    def __post_init__(self) -> None:
        """Check options that depend on each other."""
        require("--exact", self.exact, not self.exact or self.offset is not None, "with --offset only")
        ordered = self.start is None or self.end is None or self.start < self.end
        require("--end", self.end, ordered, "a time after --start")
        plain = self.name is None or (self.name.isprintable() and Path(self.name).name == self.name)
        require("--name", self.name, plain and (self.name or "0")[0] != ".", "the name of a folder")


def _pose(text: str) -> "Pose":
    import numpy as np
    import torch

    from pinwm_drake.spatial.poses import Pose

    values = np.array(_numbers(text))
    if len(values) == 7 and abs(norm := float(np.linalg.norm(values[3:]))) - 1 < 1e-3 and norm > 1 - 1e-3:
        return Pose(torch.from_numpy(values[3:] / norm), torch.from_numpy(values[:3].copy()))
    raise ParameterError(f'--pose: got "{text}"; allowed: seven numbers "x y z qw qx qy qz", with a unit quaternion')


def _shape(text: str) -> "PusherShape":
    from pinwm_drake.capture.scene import PUSHER_KINDS, PusherShape

    kind, _, rest = text.strip().partition(" ")
    sizes = _numbers(rest)
    if kind in PUSHER_KINDS and len(sizes) == (1 if kind == "sphere" else 2) and all(1e-4 <= x <= 5.0 for x in sizes):
        return PusherShape(kind, *sizes)
    raise ParameterError(
        f'--pusher-shape: got "{text}"; allowed: "sphere R", "capsule R LENGTH" or "cylinder R LENGTH", 0.0001 to 5 m'
    )


def _numbers(text: str) -> list[float]:
    """Finite numbers in a text, with spaces or commas between them; an empty list where it has something else."""
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        return []
    return values if all(math.isfinite(value) for value in values) else []
