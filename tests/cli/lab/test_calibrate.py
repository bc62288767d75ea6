# SPDX-License-Identifier: MIT
import shutil

import pytest
from typer.testing import CliRunner

from benchmarks.scenes.rendered_lab import RenderedLab
from pinwm_drake.cli.app import app
from pinwm_drake.errors import ParameterError
from pinwm_drake.experiments.requests.stations import CalibrateRequest
from pinwm_drake.station.document import load_station

RUN = CliRunner()


def test_a_board_is_printed_with_what_to_do(tmp_path):
    done = RUN.invoke(app, ["calibrate", "--board", str(tmp_path / "board.pdf"), "--squares", "7", "5"])
    assert done.exit_code == 0, done.output
    assert "for A4 paper: print it at 100 %" in done.output
    assert "measure the ruler of 100 mm" in done.output
    assert "board: {squares: [7, 5], square: 0.028, marker: 0.021, dictionary: DICT_5X5_250}" in done.output
    assert (tmp_path / "board.pdf").exists()


def test_a_lab_is_calibrated(tmp_path):
    folder = RenderedLab(1, numbers=(5, 9, 3), printed=0.97).write(tmp_path / "mylab")
    done = RUN.invoke(app, ["calibrate", str(folder)])
    assert done.exit_code == 0, done.output
    assert "the board is printed at 97.0 %" in done.output
    assert "points of the workspace are seen within" in done.output
    assert "mm (95 %)" in done.output
    station = load_station(folder / "station")
    assert station.sha256[:12] in done.output
    assert len(list((folder / "station/residuals/robot").glob("*.png"))) == 9
    shutil.rmtree(folder)


def test_a_folder_or_a_board_is_asked_for(tmp_path):
    with pytest.raises(ParameterError, match="FOLDER: got none"):
        CalibrateRequest()
    with pytest.raises(ParameterError, match="a folder and --board"):
        CalibrateRequest(folder=tmp_path, board=tmp_path / "board.pdf")
