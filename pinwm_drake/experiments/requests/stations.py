# SPDX-License-Identifier: MIT
"""Request of the calibration of a station."""

from pathlib import Path
from typing import Annotated

from pinwm_drake.errors import require
from pinwm_drake.request import DATA, LAB, argument, option, request
from pinwm_drake.station.board import DEFAULT_DICTIONARY, Board


@request
class CalibrateRequest:
    """Request of a calibration, or of a board to print: what `pinwm calibrate` does."""

    folder: Annotated[Path | None, argument("Folder of a lab with lab.yaml, robot.csv and photos.", "FOLDER")] = None
    out: Annotated[
        Path | None,
        option("Folder for station.yaml and residuals/.", "--out", "-o", default="FOLDER/station", result="inside"),
    ] = None
    board: Annotated[Path | None, option("Board to draw at true scale with a ruler, PDF or PNG.", group=LAB)] = None
    squares: Annotated[tuple[int, int], option("Squares of the board along x and y.", metavar="NX NY", group=DATA)] = (
        Board().squares
    )
    square: Annotated[float, option("Side of a square.", group=DATA, unit="m", ge=1e-3, le=1.0)] = Board().square
    marker: Annotated[float, option("Side of a marker.", group=DATA, unit="m", ge=1e-3, le=1.0)] = Board().marker
    dictionary: Annotated[str, option("OpenCV's name of the markers' dictionary.", group=DATA)] = DEFAULT_DICTIONARY

    def __post_init__(self) -> None:
        """Check that there is a folder or a board, and not both."""
        given = (self.folder is not None) + (self.board is not None)
        require(
            "FOLDER", "none" if not given else "a folder and --board", given == 1, "a lab's folder, or --board FILE"
        )
