# SPDX-License-Identifier: MIT
"""Clock of an episode's images: how it was brought to that of the pusher's log, from the optional `clock.yaml`."""

import os
from pathlib import Path
from typing import Annotated

from pinwm_drake.documents import Document, FromList, Number, Text, finite, read_yaml, schema_version, yaml_text
from pinwm_drake.files import replacing

CLOCK_FILE = "clock.yaml"
_VERSION = 1


class EpisodeClock(Document):
    """Clock of the images of an episode, whose times are on that of the log already.

    Attributes:
        offset: s; a time of the log's file is `rate` times that of the film's, plus this.
        deviation: s, standard deviation of the offset.
        interval: s, that holds the offset with 95 %.
        rate: Seconds of the log for each second of the film.
        start: s, time of the log's file at which those of the episode are 0.
        residual: px, by which the pusher is off its place in the images, as a median; None where the offset was given.
        film: File or folder of the film, as it was given.
        log: File or folder of the log.
        notes: What was guessed, dropped and missing.
    """

    schema_version: int = schema_version(_VERSION)
    offset: Number
    deviation: Annotated[float, finite(0.0, 10.0)]
    interval: Annotated[tuple[Number, Number], FromList]
    rate: Annotated[float, finite(0.1, 10.0)] = 1.0
    start: Number = 0.0
    residual: Number | None = None
    film: Text
    log: Text
    notes: Annotated[tuple[Text, ...], FromList] = ()


def read_clock(folder: Path) -> EpisodeClock | None:
    """Read the clock of an episode by its folder; None where there is no `clock.yaml`.

    Raises:
        InputError: The file cannot be read, or a key is missing, unknown or out of range.
    """
    path = folder / CLOCK_FILE
    return read_yaml(path).read(EpisodeClock) if os.path.lexists(path) else None


def write_clock(folder: Path, clock: EpisodeClock) -> None:
    """Write the clock of an episode into its folder.

    Raises:
        InputError: The file cannot be written.
    """
    head = "# Clock of the images against the pusher's log; the times in frames.csv are on the log's clock already.\n"
    with replacing(folder / CLOCK_FILE) as temporary:
        temporary.write_text(head + yaml_text(clock.model_dump()), encoding="utf-8")
