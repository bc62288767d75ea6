# SPDX-License-Identifier: MIT
"""The request of a session of pushes: what `pinwm simulate` does. Light, as the command line reads it."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

from pinwm_drake.errors import InputError, ParameterError, require
from pinwm_drake.request import ADVANCED, BUDGET, DATA, FLATTEN, LAB, argument, option, request

STRAIGHT = "straight"
_TRAJECTORY_FILE = "trajectory.csv"


@request
class SessionOptions:
    """A session of pushes in a station.

    Raises:
        ParameterError: An option is out of range.
        InputError: A file of the results is a folder.
    """

    engine: Annotated[
        Literal["twin", "hydroelastic", "point"] | None,
        option("Physics engine of the station.", default="the scenario's"),
    ] = None
    push: Annotated[str, option("Push: straight through the object, or a trajectory.csv to replay.")] = STRAIGHT
    duration: Annotated[
        float | None,
        option("Simulated duration.", group=BUDGET, unit="s", ge=0.01, le=600, default="until the object rests"),
    ] = None
    out: Annotated[
        Path | None,
        option("Folder for an episode: poses, pusher's log, images.", "--out", "-o", group=DATA, result="beside"),
    ] = None
    video: Annotated[
        Path | None, option("MP4 file of the scene beside the camera image.", group=DATA, result="beside")
    ] = None
    record: Annotated[
        Path | None, option("HTML file of the Meshcat scene; it needs no server.", group=DATA, result="beside")
    ] = None
    meshcat: Annotated[bool, option("Show pushes in the browser, in real time, until Ctrl-C.", group=LAB)] = False
    host: Annotated[str, option("Address of Meshcat; any but the default admits other machines.", group=LAB)] = (
        "localhost"
    )
    port: Annotated[int | None, option("Port of Meshcat.", group=LAB, default="first free from 7000")] = None
    seed: Annotated[
        int | None,
        option("Seed of start and push.", group=ADVANCED, ge=0, le=2**32 - 1, default="the scenario's"),
    ] = None

    def __post_init__(self) -> None:
        """Check the names of the files."""
        for name, path, suffixes in (("--record", self.record, (".html", ".htm")), ("--video", self.video, (".mp4",))):
            fits = path is None or path.suffix.lower() in suffixes
            require(name, path, fits, f"a name that ends in {' or '.join(suffixes)}")

    @property
    def log_folder(self) -> Path | None:
        """Folder of the trajectory.csv that is to be replayed; None for a straight push.

        Raises:
            ParameterError: `push` is something else.
        """
        path = Path(self.push)
        if self.push != STRAIGHT and path.name != _TRAJECTORY_FILE:
            allowed = f"{STRAIGHT}, or the path of a {_TRAJECTORY_FILE}"
            raise ParameterError(f"--push: got {self.push!r}; allowed: {allowed}")
        return None if self.push == STRAIGHT else path.parent


@request
class SimulateRequest:
    """Request of a session in a scene."""

    scenario: Annotated[
        str | None,
        argument("Scenario that ships, a .scenario.yaml file, or a twin's folder.", "SCENARIO", completes="scene"),
    ] = None
    twin: Annotated[
        Path | None,
        option("Twin that replaces the scenario's object.", group=DATA, default="none", completes="twin"),
    ] = None
    options: Annotated[SessionOptions, FLATTEN] = dataclasses.field(default_factory=SessionOptions)

    def __post_init__(self) -> None:
        """Check that there is a scene, and that no folder has the name of a file."""
        from pinwm_drake.models import shipped_scenarios

        named = self.scenario is not None or self.twin is not None
        require("SCENARIO", "none, and no --twin", named, f"a file, {', '.join(shipped_scenarios())}")
        for path in (self.options.record, self.options.video):
            if path is not None and path.is_dir():
                raise InputError(path, value="a folder", allowed="a file")
