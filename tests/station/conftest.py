# SPDX-License-Identifier: MIT
import cv2
import pytest

from benchmarks.rendered_lab import RenderedLab
from pinwm_drake.station.calibrate import calibrate

NUMBERS = (5, 12, 4)


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(before)


@pytest.fixture(scope="session")
def fixed(tmp_path_factory):
    """A rendered lab with a fixed camera: its truth, its calibration and its station."""
    truth = RenderedLab(1, numbers=NUMBERS)
    return truth, *calibrate(truth.write(tmp_path_factory.mktemp("fixed") / "mylab"))
