# SPDX-License-Identifier: MIT
from pathlib import Path

import numpy as np
import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.station.clock import find
from pinwm_drake.station.clock.coarse import stillness
from pinwm_drake.station.clock.find import find_clock, find_cut
from pinwm_drake.station.clock.patches import path_weights
from tests.station.drawn_push import RATE, draw_push, place

FILM = Path("push.mp4")
# The bar of the issue; the error of these films is about 1 ms.
BAR = 5e-3


@pytest.fixture(scope="module")
def push():
    return draw_push()


@pytest.mark.parametrize(
    ("seed", "offset"), [(1, -1.45), *(pytest.param(*one, marks=pytest.mark.nightly) for one in ((2, 0.02), (3, 1.3)))]
)
def test_offsets_are_found(seed, offset):
    push = draw_push(seed, offset)
    fit = find_clock(push.film(), FILM)
    assert fit.offset == pytest.approx(offset, abs=BAR)
    assert fit.rate == 1.0
    low, high = fit.interval
    # Four standard deviations: a chance of 6e-5 that a right interval misses.
    assert fit.offset - 2 * (fit.offset - low) - 1e-9 <= offset <= fit.offset + 2 * (high - fit.offset) + 1e-9


def test_frames_may_come_at_any_time_and_be_missing(push):
    random = np.random.default_rng(0)
    which = np.sort(random.permutation(len(push.t))[: len(push.t) - 12])
    assert find_clock(push.film(which), FILM).offset == pytest.approx(push.offset, abs=BAR)


def test_a_clock_that_drifts_is_told(push):
    fast = 1.015
    fit = find_clock(push.film(t=push.t / fast), FILM)
    assert fit.rate == pytest.approx(fast, abs=5e-3)
    middle = push.t[len(push.t) // 2]
    assert fit.offset + fit.rate * middle / fast == pytest.approx(push.offset + middle, abs=BAR)


def test_a_drift_on_which_the_bands_do_not_agree_is_none(push, monkeypatch):
    film = push.film(t=push.t / 1.015)
    rates = np.array([1.08, 1.07, 0.94])  # as of a rod whose end an object hides
    monkeypatch.setattr(find, "rates_of_bands", lambda *_: rates)
    fit = find_clock(film, FILM)
    assert fit.rate == 1.0
    middle = push.t[len(push.t) // 2]
    assert fit.offset + middle / 1.015 == pytest.approx(push.offset + middle, abs=2 * BAR)


def test_patches_stand_still_at_the_right_offset_alone(push):
    film = push.film()
    right = stillness(film, push.offset)
    assert right > 0.6
    for wrong in (-0.3, -0.1, 0.1, 0.3):
        assert stillness(film, push.offset + wrong) < right - 0.05
    assert stillness(film, push.offset + 60) == -1.0  # there the pusher rests


def test_weights_are_the_way_around_a_frame():
    centre = np.array([[0.0, 0], [0, 0], [3, 4], [3, 4]])
    assert path_weights(centre).tolist() == [0, 2.5, 2.5, 0]


def test_a_cut_is_found_where_it_is(push):
    kept = (push.t < 0.7) | (push.t >= 0.95)
    film = push.film(kept, t=push.t[: kept.sum()])
    time, jump, *_ = find_cut(film, push.offset)
    assert time == pytest.approx(0.7, abs=2.5 / RATE)
    assert jump == pytest.approx(0.25, abs=0.05)
    assert find_cut(push.film(), push.offset) is None


def other_run(push):
    """The log of a push along another line."""
    t = push.log_t - push.offset
    return push.log_t, place(t, (-0.02, 0.16)) + np.array([0.05, -0.05, 0])


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        (r"cut near 0\.[67]", lambda push: push.film(k := (push.t < 0.7) | (push.t >= 0.95), t=push.t[: k.sum()])),
        pytest.param("the log of another run", lambda push: push.film(log=other_run(push)), marks=pytest.mark.nightly),
        ("another clock: a second of the film is 1.2 s", lambda push: push.film(t=push.t / 1.2)),
        # Films that end before the pusher stops, whose offset could make up for the rate.
        ("a second of the film is 1.1 s", lambda push: push.film(k := push.t < 0.8, t=push.t[k] / 1.1)),
        pytest.param(
            r"a second of the film is 0\.85",
            lambda push: push.film(k := push.t < 0.8, t=push.t[k] / 0.85),
            marks=pytest.mark.nightly,
        ),
        (r"another clock: the log shows this motion -3\.\d* s away", lambda push: push.film(t=push.t + 4)),
        ("that is sure to|another run", lambda push: push.film(slice(0, 8))),
    ],
)
def test_wrong_inputs_are_named(push, words, wrong):
    with pytest.raises(InputError, match=words) as raised:
        find_clock(wrong(push), FILM)
    assert str(raised.value).startswith("push.mp4: got ")
    assert "\n" not in str(raised.value)


def test_a_mirrored_image_is_named(push):
    frames = push.frames
    object.__setattr__(push, "frames", frames[:, :, ::-1])
    try:
        with pytest.raises(InputError, match="a mirrored image"):
            find_clock(push.film(), FILM)
    finally:
        object.__setattr__(push, "frames", frames)
