# SPDX-License-Identifier: MIT
"""`pinwm calibrate`: a board to print, and the calibration of a lab with its accuracy in lines."""

from typing import TYPE_CHECKING

from pinwm_drake.cli.console import say, stages_bar, warn
from pinwm_drake.experiments.requests.stations import CalibrateRequest

if TYPE_CHECKING:
    from pinwm_drake.station.calibrate import Calibration
    from pinwm_drake.station.document import Station


def calibrate(request: CalibrateRequest) -> None:
    """Find lens, place of the camera and table of a lab by a board.

    FOLDER has lab.yaml, robot.csv, and photos of the board in lens/, robot/ and table/. --board draws the board.
    """
    from pinwm_drake.station.board import RULER, Board, draw_board

    if request.board is not None:
        board = Board(request.squares, request.square, request.marker, request.dictionary)
        paper = draw_board(board, request.board)
        on = f" for {paper} paper" if paper else ""
        say(f"wrote {request.board}{on}: print it at 100 %, without fitting to the page")
        say(f"measure the ruler of {1e3 * RULER:.0f} mm, and put its length into lab.yaml as ruler, in m")
        say(f"board: {board.words()}")
        return
    from pinwm_drake.station.calibrate import PICTURES, calibrate

    assert request.folder is not None
    with stages_bar() as show:
        found, station = calibrate(request.folder, request.out, show)
    for note in found.notes:
        warn(note)
    for line in words(found, station):
        say(line)
    say(f"wrote {station.path} (SHA-256 {station.sha256[:12]}...); residuals as pictures are in {PICTURES}/ beside it")


def words(found: "Calibration", station: "Station") -> list[str]:
    """Accuracy of a calibration, one line each."""
    import numpy as np

    noise, reached = found.solution.bundle.noise, found.accuracy
    lens, table = found.solution.lens, station.document.world.table
    fx, fy, cx, cy = lens.intrinsics
    return [
        f"lens: {lens.model}, fx {fx:.1f}, fy {fy:.1f}, cx {cx:.1f}, cy {cy:.1f} px; corners are {noise.pixel:.3f} px "
        "off on each axis",
        f"robot: {1e3 * noise.place:.2f} mm and {np.degrees(noise.angle):.3f} degrees off on each axis, over "
        f"{sum(block.trusted for block in found.solution.bundle.told)} poses",
        reached.words(),
        f"table: z = {1e3 * table.height:.2f} mm in W, within {1e3 * reached.height:.2f} mm; tilt "
        f"{np.degrees(table.tilt):.3f} degrees, within {np.degrees(reached.tilt):.3f} (95 %)",
    ]
