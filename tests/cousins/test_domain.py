# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest

from pinwm_drake.cousins.domain import CousinDomains
from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.twin.twin import Draws


def _twin_with(**intervals):
    twin = load_setup("flip_mug").twin
    theta = {name: replace(twin.theta[name], interval=interval) for name, interval in intervals.items()}
    return replace(twin, theta=twin.theta | theta)


def test_a_friction_that_is_known_roughly_is_drawn_from_the_posterior_and_the_others_around_the_twin():
    twin = _twin_with(friction_floor=(0.195, 0.206), friction_pusher=(0.3, 1.2))
    values = np.column_stack([np.linspace(0.18, 0.22, 50), np.linspace(1.2, 0.3, 50)])
    twin = replace(twin, draws=Draws(["friction_floor", "friction_pusher"], values))
    domains = CousinDomains(widen=True)
    assert domains.wide(twin) == {"friction_pusher": (0.3, 1.2)}
    draw, draw_plain = domains.draw(twin), CousinDomains().draw(twin)
    drawn = [draw(number).theta for number in range(200)]
    pusher = np.array([theta["friction_pusher"] for theta in drawn])
    assert set(pusher) <= set(values[:, 1])
    assert pusher.min() < 0.35
    assert pusher.max() > 1.15
    floor = [theta["friction_floor"] for theta in drawn]
    plain = [draw_plain(number).theta["friction_floor"] for number in range(200)]
    assert floor == plain
    assert not CousinDomains().wide(twin)


def test_without_draws_a_wide_friction_is_drawn_evenly_from_its_interval():
    draw = CousinDomains(widen=True).draw(_twin_with(friction_pusher=(-0.1, 1.1)))
    drawn = [draw(number) for number in range(300)]
    pusher = np.array([cousin.theta["friction_pusher"] for cousin in drawn])
    assert 0.0 <= pusher.min() < 0.05
    assert pusher.mean() == pytest.approx(0.55, abs=0.06)


def test_frictions_that_are_given_are_drawn_evenly_in_place_of_all_others():
    twin = _twin_with(friction_pusher=(0.3, 1.2))
    domains = CousinDomains(0.0, friction_floor=(0.1, 0.3), friction_pusher=(0.5, 0.5), widen=True)
    draw = domains.draw(twin)
    drawn = [draw(number).theta for number in range(300)]
    assert {theta["friction_pusher"] for theta in drawn} == {0.5}
    floor = np.array([theta["friction_floor"] for theta in drawn])
    assert 0.1 <= floor.min() < 0.11
    assert floor.mean() == pytest.approx(0.2, abs=0.015)
    assert domains.about()["friction_floor"] == [0.1, 0.3]
    assert draw(7).theta == domains.draw(twin)(7).theta
    with pytest.raises(ParameterError, match=r"friction_floor: got 0\.3 to 0\.1"):
        CousinDomains(friction_floor=(0.3, 0.1)).draw(twin)


def test_a_spread_is_one_factor_of_all_axes_and_changes_nothing_else():
    twin = _twin_with(friction_pusher=(0.4, 1.1))
    draw, plain = CousinDomains(spread=(1.0, 1.8)).draw(twin), CousinDomains().draw(twin)
    found = [[draw(k).shape[f"support_{axis}"] for axis in "xyz"] for k in range(40)]
    assert all(one[0] == one[1] == one[2] for one in found)
    values = [one[0] for one in found]
    assert min(values) >= 1.0
    assert max(values) <= 1.8
    assert np.std(values) == pytest.approx(0.8 / 12**0.5, rel=0.25)
    assert draw(3).theta == plain(3).theta
    assert CousinDomains(spread=(1.0, 1.8)).about() == {**CousinDomains().about(), "spread": [1.0, 1.8]}
    with pytest.raises(ParameterError, match="spread"):
        CousinDomains(spread=(1.8, 1.0)).draw(twin)
