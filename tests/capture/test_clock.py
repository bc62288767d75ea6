# SPDX-License-Identifier: MIT
import re

import pytest

from pinwm_drake.capture.clock import CLOCK_FILE, EpisodeClock, read_clock, write_clock
from pinwm_drake.errors import InputError

CLOCK = EpisodeClock(
    schema_version=1,
    offset=0.25,
    deviation=0.001,
    interval=(0.248, 0.252),
    film="push.mp4",
    log="robot.csv",
    notes=("2 rows dropped: ü",),
)


@pytest.mark.parametrize("film", ["push.mp4", "1e3", "2024-01-01", "null"])
def test_a_clock_is_read_as_it_was_written(tmp_path, film):
    assert read_clock(tmp_path) is None
    clock = CLOCK.model_copy(update={"film": film})
    write_clock(tmp_path, clock)
    assert read_clock(tmp_path) == clock


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("offset: 0.25", "offset: .nan", "offset"),
        ("deviation: 0.001", "deviation: -1", "deviation"),
        ("schema_version: 1", "schema_version: 2", "schema_version"),
        ("film: push.mp4", "flim: push.mp4", "no film"),
    ],
)
def test_a_wrong_clock_is_refused(tmp_path, old, new, words):
    write_clock(tmp_path, CLOCK)
    text = (tmp_path / CLOCK_FILE).read_text()
    assert old in text
    (tmp_path / CLOCK_FILE).write_text(text.replace(old, new))
    with pytest.raises(InputError, match=re.escape(words)):
        read_clock(tmp_path)
