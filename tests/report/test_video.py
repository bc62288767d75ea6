# SPDX-License-Identifier: MIT
import cv2
import numpy as np
import pytest

from pinwm_drake.report import video
from pinwm_drake.report.video import write_video

SIZE = (64, 48)


def pictures(number):
    """Pictures with a white square that goes to the right, on grey."""
    for k in range(number):
        picture = np.full((SIZE[1], SIZE[0], 3), (90, 90, 160), np.uint8)
        picture[16:32, 8 + 4 * k : 24 + 4 * k] = 255
        yield picture


@pytest.mark.parametrize("codec", [0, 1])
def test_frames_come_back_as_they_were_written(shipped_codecs, monkeypatch, tmp_path, codec):
    monkeypatch.setattr(video, "_CODECS", shipped_codecs[codec:])
    write_video(tmp_path / "film.mp4", pictures(6), rate=25.0, size=SIZE)
    film = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert film.get(cv2.CAP_PROP_FPS) == pytest.approx(25.0)
    assert film.get(cv2.CAP_PROP_FOURCC) == (cv2.VideoWriter.fourcc(*"VP90"), cv2.VideoWriter.fourcc(*"FMP4"))[codec]
    for picture in pictures(6):
        found, frame = film.read()
        assert found
        assert np.abs(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB).astype(int) - picture).mean() < 8
    assert not film.read()[0]
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]
