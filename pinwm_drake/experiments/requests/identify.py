# SPDX-License-Identifier: MIT
"""Requests of commands that make a twin of a capture: align and identify."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated

from pinwm_drake.errors import ParameterError
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.request import BUDGET, DATA, FLATTEN, LAB, argument, option, request

_Resume = Annotated[bool, option("Continue an interrupted run with the same input.", group=BUDGET)]
_View = Annotated[bool, option("Show the run while it goes on, on the page progress.html in the folder.", group=LAB)]


@request
class AlignRequest:
    """Request of a fit of surfels: what `pinwm align` does."""

    source: Annotated[
        Path,
        argument("Capture, or images with a nerfstudio transforms.json.", "IMAGES_OR_CAPTURE", completes="capture"),
    ]
    out: Annotated[
        Path, argument("Folder for surfels.ply, align.json, pictures, film and page.", "OUT", result="inside")
    ]
    mesh: Annotated[Path | None, option("Mesh of the object in metres.", group=DATA, default="the capture's")] = None
    fit: Annotated[FitOptions, FLATTEN] = dataclasses.field(default_factory=FitOptions)
    resume: _Resume = False
    view: _View = False


@request
class IdentifyRequest:
    """Request of an identification: what `pinwm identify` does."""

    capture: Annotated[Path, argument("Capture of an object and one push or more.", "CAPTURE", completes="capture")]
    twin: Annotated[Path, argument("Folder of the twin; surfels in it are used.", "TWIN", result="inside")]
    episodes: Annotated[
        tuple[str, ...],
        option("Name of a push; repeat it for several.", "--episode", group=DATA, default="the first"),
    ] = ()
    poses: Annotated[
        Path | None,
        option("Measured poses to fit in place of images: a file, or a file's name in each push's folder.", group=DATA),
    ] = None
    free: Annotated[
        tuple[str, ...],
        option(
            "Physical parameter to estimate, such as mass; repeat it.",
            default="friction_floor, friction_pusher, moment_xx, moment_yy",
        ),
    ] = ()
    hold: Annotated[
        tuple[str, ...],
        option("Value at which a parameter is held, or starts if it is free.", metavar="NAME=VALUE"),
    ] = ()
    without: Annotated[
        tuple[str, ...], option("Nuisance parameter to switch off, such as time_offset; repeat it.")
    ] = ()
    search: Annotated[IdentifyOptions, FLATTEN] = dataclasses.field(default_factory=IdentifyOptions)
    directions: Annotated[int | None, option("Option of version 0.1 without effect.", hidden=True)] = None
    resume: _Resume = False
    view: _View = False

    def options(self) -> IdentifyOptions:
        """Options of the search, with the unknowns of the request.

        Raises:
            ParameterError: A name is unknown, a value is no number, or no unknown is left.
        """
        from pinwm_drake.identification.unknowns import DEFAULT_FREE, NUISANCES, UNKNOWNS

        held = dict(map(_held, self.hold))
        for name, names in (("--free", self.free), ("--hold", tuple(held)), ("--without", self.without)):
            for one in names:
                if one not in UNKNOWNS:
                    raise ParameterError(f"{name}: got {one!r}; allowed: {', '.join(UNKNOWNS)}")
        left_out = {*self.without, *(name for name in held if name not in self.free)}
        wanted = (*self.free, *NUISANCES) if self.free else DEFAULT_FREE
        chosen = tuple(dict.fromkeys(name for name in wanted if name not in left_out))
        if not chosen:
            raise ParameterError(
                "--without, --hold: got all unknowns, so that none is left to find; allowed: one free unknown or more"
            )
        return dataclasses.replace(self.search, free=chosen, held=held)


def _held(text: str) -> tuple[str, float]:
    name, equals, number = text.partition("=")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not equals or not math.isfinite(value):
        raise ParameterError(f"--hold: got {text!r}; allowed: NAME=VALUE, as in friction_pusher=0.2")
    return name, value
