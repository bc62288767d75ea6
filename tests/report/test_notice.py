# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.report.notice import draw_notice


def test_lines_are_drawn_in_their_colours_one_below_the_other():
    picture = draw_notice([("first", "#ff0000"), ("second", "#0000ff")])
    assert picture.shape[1:] == (700, 4)
    assert picture[0, 0, 3] == 0  # round corners
    letters = picture[..., :3].astype(int)
    red = np.flatnonzero((letters[..., 0] - letters[..., 2] > 128).any(axis=1))
    blue = np.flatnonzero((letters[..., 2] - letters[..., 0] > 128).any(axis=1))
    assert 0 < red.max() < blue.min() < len(picture)


@pytest.mark.parametrize("text", ["a long text " * 12, "x" * 200])
def test_a_long_text_takes_more_rows(text):
    one = draw_notice([("short", "#000000")])
    rows = draw_notice([(text, "#000000")])
    assert rows.shape[1] == one.shape[1]
    if " " in text:
        assert len(rows) > len(one)
    assert len(draw_notice([("short", "#000000")], height=300)) == 300
