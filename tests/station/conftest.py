# SPDX-License-Identifier: MIT
import cv2
import pytest

from benchmarks.scenes.rendered_lab import RenderedLab
from pinwm_drake.station.board import Detector
from pinwm_drake.station.calibrate import calibrate

NUMBERS = (5, 12, 4)


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(before)


@pytest.fixture(scope="session", autouse=True)
def detect_once():
    """Looks for the corners of a board in a photo once, as most tests of a lab change few of its photos."""
    detect, found = Detector._detect, {}

    def once(self, grey):
        key = self._board, grey.shape, grey.tobytes()
        if key not in found:
            found[key] = detect(self, grey)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Detector, "_detect", once)
        yield


@pytest.fixture(scope="session")
def fixed(tmp_path_factory):
    """A rendered lab with a fixed camera and a print of 95 %: its truth, its calibration and its station."""
    truth = RenderedLab(1, numbers=NUMBERS, printed=0.95)
    return truth, *calibrate(truth.write(tmp_path_factory.mktemp("fixed") / "mylab"))
