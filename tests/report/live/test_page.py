# SPDX-License-Identifier: MIT
import re

import cv2
import numpy as np

from pinwm_drake.report.live.page import PAGE_FILE, PICTURE_FILE, ProgressPage

RED, BLUE = np.tile([0.9, 0.1, 0.1], (20, 30, 1)), np.tile([0.1, 0.1, 0.9], (20, 30, 1))


def pixels(path, colour: str) -> int:
    """Number of pixels of a picture that are red or blue."""
    blue, _, red = (cv2.imread(str(path))[..., k].astype(int) for k in range(3))
    return int(({"red": red - blue, "blue": blue - red}[colour] > 150).sum())


def test_the_page_shows_pictures_beside_renderings_and_reloads_itself(tmp_path):
    page = ProgressPage(tmp_path, "a run & more")
    page.add("coarse", 0.5)
    page.add("sample", float("nan"))
    page.update(0.25, "coarse  loss 0.5", lambda: [(RED, BLUE)])
    text = (tmp_path / PAGE_FILE).read_text()
    assert "<h1>a run &amp; more</h1>" in text
    assert '<meta http-equiv="refresh" content="3">' in text
    assert "25 %, coarse  loss 0.5" in text
    assert not re.search(r"https?://|src=\"(?!data:)", text)
    picture = tmp_path / PICTURE_FILE
    assert pixels(picture, "red") > 1000
    assert pixels(picture, "blue") > 1000
    # Nothing else is left, such as half a file.
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([PAGE_FILE, PICTURE_FILE])
    page.end("loss 0.1 after 3 s", lambda: [(BLUE, BLUE)])
    text = (tmp_path / PAGE_FILE).read_text()
    assert "refresh" not in text
    assert "100 %, loss 0.1 after 3 s" in text
    assert pixels(picture, "red") == 0


def test_it_draws_only_when_it_is_due(tmp_path, monkeypatch):
    now, asked = [100.0], []

    def pairs():
        asked.append(now[0])
        now[0] += 2.0  # so long it takes
        return []

    monkeypatch.setattr("pinwm_drake.report.live.page.time.monotonic", lambda: now[0])
    page = ProgressPage(tmp_path, "a run", every=3.0, share=0.05)
    for _ in range(200):
        page.update(0.5, "", pairs)
        now[0] += 0.5
    # 2 s of drawing, and then 40 s of the run.
    assert asked == [100.0, 142.0, 184.0]
