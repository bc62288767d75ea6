# SPDX-License-Identifier: MIT
"""Requests of commands that read a twin: predict, next-push, cousins, model, report and view."""

import math
from pathlib import Path
from typing import Annotated, Literal

from pinwm_drake.errors import InputError, require
from pinwm_drake.request import ADVANCED, BUDGET, DATA, LAB, argument, option, request

TwinFolder = Annotated[Path, argument("Folder that `pinwm identify` wrote.", "TWIN", completes="twin")]
_ANYWHERE = {"default": "anywhere", "allowed": "low below high"}


def require_suffix(name: str, path: Path | None, *suffixes: str) -> None:
    """Require that a file has one of some endings, and that no folder has its name.

    Raises:
        ParameterError: It has another ending.
        InputError: It is a folder.
    """
    fits = path is None or path.suffix.lower() in suffixes
    require(name, path, fits, f"a name that ends in {' or '.join(suffixes)}")
    if path is not None and path.is_dir():
        raise InputError(path, value="a folder", allowed="a file")


@request
class PredictRequest:
    """Request of a prediction: what `pinwm predict` does."""

    twin: TwinFolder
    episode: Annotated[Path, argument("Folder CAPTURE/episodes/NAME of any capture of the object.", "EPISODE")]
    out: Annotated[
        Path, option("File for the poses, with the columns of object_poses.csv.", "--out", "-o", result="beside")
    ]
    find_start: Annotated[
        bool, option("Locate the object in the first image; capture.yaml is ignored.", group=DATA)
    ] = False
    plot: Annotated[Path | None, option("PNG file for the motion over time and its 95 % band.", group=LAB)] = None
    video: Annotated[Path | None, option("MP4 file for camera, twin and difference side by side.", group=LAB)] = None

    def __post_init__(self) -> None:
        """Check the names of the files."""
        require_suffix("--plot", self.plot, ".png")
        require_suffix("--video", self.video, ".mp4")


@request
class NextPushRequest:
    """Request of a proposal: what `pinwm next-push` does."""

    twin: Annotated[
        Path,
        argument("Folder that `pinwm identify` wrote, or a capture before its first push.", "TWIN", completes="twin"),
    ]
    out: Annotated[
        Path, option("Folder for push.yaml, trajectory.csv and next_push.png.", "--out", "-o", result="inside")
    ]
    motion: Annotated[
        Literal["push", "poke"] | None,
        option(
            "Motion that is proposed: level, or short, fast and upwards.",
            default="that of the twin's capture, level before its first push",
        ),
    ] = None
    position: Annotated[float, option("Spread of the resting position that is good enough.", unit="mm", gt=0)] = 2.0
    yaw: Annotated[float, option("Spread of the resting yaw that is good enough.", unit="deg", gt=0)] = 2.0
    low: Annotated[
        tuple[float, float] | None,
        option("Lowest x and y of the pusher.", group=LAB, unit="m", metavar="X Y", **_ANYWHERE),
    ] = None
    high: Annotated[
        tuple[float, float] | None,
        option("Highest x and y of the pusher.", group=LAB, unit="m", metavar="X Y", **_ANYWHERE),
    ] = None
    candidates: Annotated[int, option("Number of random pushes that are compared.", group=BUDGET, ge=1)] = 48
    draws: Annotated[int, option("Number of draws of the twin for each push.", group=BUDGET, ge=2)] = 32
    seed: Annotated[int, option("Seed of the random pushes.", group=ADVANCED, ge=0)] = 0

    def __post_init__(self) -> None:
        """Check the box."""
        least, most = self.box
        below = all(low < high for low, high in zip(least, most, strict=True))
        require("--low, --high", f"{least} and {most}", below, "low below high")

    @property
    def box(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Corners of the pusher's box in x and y, m; infinite where there is none."""
        return self.low or (-math.inf, -math.inf), self.high or (math.inf, math.inf)


@request
class CousinsRequest:
    """Request of a draw of cousins: what `pinwm cousins` does."""

    twin: TwinFolder
    out: Annotated[Path, option("Folder for cousins.npz and cousins.png.", "--out", "-o", result="inside")]
    number: Annotated[int, option("Number of cousins.", ge=1, le=200)] = 16
    delta: Annotated[float, option("Relative half-width of the draws.", ge=0, lt=1)] = 0.1
    from_intervals: Annotated[bool, option("Draw identified parameters from the twin's posterior.")] = False
    seed: Annotated[int, option("Seed of the draws.", group=ADVANCED, ge=0)] = 0


@request
class ModelRequest:
    """Request of SDFormat models: what `pinwm model` does."""

    twin: TwinFolder
    out: Annotated[
        Path,
        argument("Folder for the SDFormat files and their meshes.", "OUT", result="beside"),
    ]


@request
class ReportRequest:
    """Request of a report: what `pinwm report` does."""

    twin: TwinFolder
    out: Annotated[
        Path | None, option("HTML file of the report.", "--out", "-o", default="TWIN/report.html", result="beside")
    ] = None
    capture: Annotated[
        Path | None,
        option("Folder of the capture if it has moved.", group=DATA, default="as in the twin", completes="capture"),
    ] = None

    def __post_init__(self) -> None:
        """Check the name of the file."""
        require_suffix("--out", self.path, ".html", ".htm")

    @property
    def path(self) -> Path:
        """File of the report."""
        return self.twin / "report.html" if self.out is None else self.out


@request
class ViewRequest:
    """Request of a view of surfels: what `pinwm view` does."""

    splats: Annotated[
        Path, argument("PLY file of surfels, a folder with surfels.ply, or a twin.", "SPLATS", completes="twin")
    ]
    html: Annotated[Path | None, option("HTML file to write instead of serving a page.", result="beside")] = None
    video: Annotated[
        Path | None, option("MP4 file of a turntable to write instead of serving a page.", result="beside")
    ] = None
    size: Annotated[
        int,
        option(
            "Width and height of the video.",
            unit="px",
            ge=16,
            le=4096,
            multiple_of=2,
            allowed="an even number from 16 to 4096 px",
        ),
    ] = 480
    seconds: Annotated[float, option("Length of the video: one turn.", unit="s", ge=0.1, le=600)] = 4.0
    host: Annotated[str, option("Address of the server; any but the default admits other machines.", group=LAB)] = (
        "127.0.0.1"
    )
    port: Annotated[
        int | None,
        option("Port of the server.", group=LAB, ge=1, le=65535, default="first free from 7000"),
    ] = None
    browser: Annotated[bool, option("Open the page in a browser as well.", group=LAB)] = False

    def __post_init__(self) -> None:
        """Check the names of the files."""
        require_suffix("--html", self.html, ".html", ".htm")
        require_suffix("--video", self.video, ".mp4")
