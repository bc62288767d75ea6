# SPDX-License-Identifier: MIT
"""Clocks of a robot and its hearer, and what is wrong between them."""

import math

import numpy as np
import pytest

from pinwm_drake.systems.engines.lcm.hearing import (
    LATCHED,
    LIVE,
    WAITING,
    Hearing,
    Least,
    hear_image,
    hear_session,
    hear_state,
    link_fault,
)

PERIOD, TIMEOUT, SESSION = 0.005, 0.1, 77
AHEAD = 1000.0  # s, robot's clock


def state(session=0, sequence=-1, mode=WAITING, fault=0):
    return [0.1, 0.2, 0.03, 0.0, 0.0, 0.0, float(session), float(sequence), float(mode), float(fault)]


def heard(t, *, delay=0.0, before=None, **values):
    """A state that was sent at t and takes some time."""
    before = before or Hearing()
    now = t + delay
    return hear_state(before, AHEAD + t, state(**values), now, now, PERIOD, TIMEOUT)


def live(seconds=0.5, delay=0.001, drift=0.0, images_late=0.0, jitter=0.0, every=PERIOD):
    """A robot that takes our commands: the hearing at the end, and the ages of its images."""
    known, ages, generator = hear_session(Hearing(), SESSION, 0.0), [], np.random.default_rng(0)
    for k in range(1, round(seconds / every)):
        t = k * every
        now = t + delay + jitter * generator.random()
        stamp = AHEAD + (1.0 + drift) * t
        values = state(SESSION, math.floor((t - delay) / PERIOD), LIVE) if t > delay else state()
        known = hear_state(known, stamp, values, now, now, PERIOD, TIMEOUT)
        if k % 10 == 0:
            now += images_late
            known = hear_image(known, stamp, now, now, PERIOD)
            ages.append(now - known.image_time)
    return known, np.array(ages)


def test_the_least_value_is_that_of_the_last_two_windows():
    least = Least()
    assert least.value == math.inf
    values = {0.0: 3.0, 1.0: 1.0, 5.5: 4.0, 9.0: 2.0, 10.6: 5.0, 16.0: 6.0, 40.0: 7.0}
    found = []
    for time, value in values.items():
        least = least.take(value, time)
        found.append(least.value)
    assert found == [3.0, 1.0, 1.0, 1.0, 2.0, 5.0, 7.0]


def test_times_are_the_hearers_and_an_image_is_as_old_as_it_took_longer():
    known, ages = live()
    assert known.time == pytest.approx(0.495 + 0.001, abs=1e-6)
    assert np.abs(ages).max() < 1e-6
    _, ages = live(images_late=0.5, seconds=2.0)
    np.testing.assert_allclose(ages, 0.5, atol=1e-6)


def test_what_takes_as_long_both_ways_is_a_round_trip():
    known, _ = live(delay=0.03)
    assert 0.055 < known.round_trip.value < 0.07
    assert link_fault(known, 0.6, TIMEOUT) == ""
    known, _ = live(delay=0.5, seconds=3.0)
    assert link_fault(known, 3.5, TIMEOUT).startswith("robot answers after 1.0")


@pytest.mark.parametrize("drift", [1e-4, -1e-4])
def test_a_clock_that_drifts_does_no_harm(drift):
    known, ages = live(seconds=500.0, drift=drift, jitter=0.002, every=0.02)
    # In two windows of 5 s it gains 1 ms; jitter is 2 ms.
    assert np.abs(ages).max() < 0.004
    assert link_fault(known, 500.0, TIMEOUT) == ""


def test_an_image_keeps_the_time_that_it_came_with():
    known = heard(1.0, delay=0.01)
    known = hear_image(known, AHEAD + 1.0, 1.03, 1.03, PERIOD)
    assert known.image_time == pytest.approx(1.01)
    again = hear_image(heard(1.005, before=known), AHEAD + 1.0, 1.1, 1.1, PERIOD)
    assert again.image_time == known.image_time
    # One that overtakes all states is of the present; one that is stamped ahead is not.
    assert hear_image(known, AHEAD + 1.05, 1.057, 1.057, PERIOD).image_time == 1.057
    assert hear_image(known, AHEAD + 3.0, 1.1, 1.1, PERIOD).image_time > 2.9
    # Before any state nothing is known of its time.
    early = hear_image(Hearing(), AHEAD, 0.5, 0.5, PERIOD)
    assert early.image_time == -math.inf
    early = hear_image(heard(0.6, before=early), AHEAD, 0.61, 0.61, PERIOD)
    assert early.image_time == pytest.approx(0.0, abs=1e-9)


def test_a_simulation_that_is_behind_makes_nothing_older():
    known = heard(1.0)
    # The wall clock has gone on by 80 ms; the simulation has not.
    late = hear_state(known, AHEAD + 1.08, state(), 1.0, 1.08, PERIOD, TIMEOUT)
    assert late.offset.value == pytest.approx(known.offset.value)
    assert late.time == pytest.approx(1.0)


def test_a_clock_that_goes_back_is_a_fault_but_for_a_robot_that_begins_anew():
    armed = hear_session(heard(5.0), SESSION, 5.0)
    assert "went back by 2.000 s" in heard(3.0, delay=3.0, before=armed).fault
    assert "went back" in heard(4.995, before=heard(5.0)).fault
    anew = hear_state(heard(5.0), 0.1, state(), 9.0, 9.0, PERIOD, TIMEOUT)
    assert (anew.stamp, anew.fault) == (0.1, "")
    assert anew.time == 9.0


def test_a_state_of_another_size_is_a_fault():
    assert "6 values; allowed: 10" in hear_state(Hearing(), 1.0, [0.0] * 6, 1.0, 1.0, PERIOD, TIMEOUT).fault


@pytest.mark.parametrize(
    ("opened", "values", "after", "words"),
    [
        (True, {"session": SESSION, "mode": LIVE}, 1.0, ""),
        (True, {"mode": LATCHED, "fault": 1}, 0.01, "robot has stopped: commands of two sessions came"),
        (False, {"mode": LATCHED, "fault": 2}, 0.05, ""),
        (False, {"mode": LATCHED, "fault": 2}, 0.15, "robot has stopped: an older command came again"),
        (True, {"session": 5, "mode": LIVE}, 0.01, "robot takes the commands of another session"),
        (True, {"mode": WAITING}, 0.01, "robot has closed the session"),
        (False, {"mode": WAITING}, 0.05, ""),
        (False, {"mode": WAITING}, 0.15, "robot takes no commands of this session"),
    ],
)
def test_what_a_robot_says_of_the_session(opened, values, after, words):
    known = hear_session(heard(1.0), SESSION, 1.0)
    if opened:
        known = heard(1.005, before=known, session=SESSION, sequence=200, mode=LIVE)
    known = heard(1.01, before=known, sequence=200, **values)
    found = link_fault(known, 1.0 + after, TIMEOUT)
    assert found.startswith(words)
    assert bool(found) == bool(words)
    # Whoever is not armed has no session to lose.
    assert link_fault(hear_session(known, 0, 1.2), 1.2, TIMEOUT) == ""


def test_a_fault_of_one_state_stays_for_the_session_for_whoever_looks_less_often():
    heard = hear_session(Hearing(), 7, 0.0)
    good = [0.0] * 6 + [7.0, 1.0, 1.0, 0.0]
    for k, values in enumerate([good, [math.nan, *good[1:]], good]):
        heard = hear_state(heard, 1.0 + 0.005 * k, values, 0.005 * k, 0.005 * k, 0.005, 0.1)
    assert heard.fault.startswith("robot's state has [nan")
    assert hear_session(heard, 8, 0.1).fault == ""
