# SPDX-License-Identifier: MIT
import dataclasses

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.math import RigidTransform

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.pusher.choice import random_push
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.runs.episode import Episode
from pinwm_drake.systems.scenario.schema import Pusher, Scenario, Shape, Start, Theta
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.scenario.start import Place, level_height
from pinwm_drake.systems.station.station import make_station

H = 1 / 240
REST = RigidTransform([0.0, 0.0, 0.025])
PUSH = StraightPush(np.array([0.0, -0.075, 0.025]), np.array([0.0, 1.0, 0.0]), 0.2, 0.04, 10.0)


def setup_of(**changes: object) -> Setup:
    theta = Theta(friction_floor=0.3, friction_pusher=0.1)
    return make_setup(Scenario(object="t_block", theta=theta, **changes))


@pytest.fixture(scope="module")
def setup() -> Setup:
    return setup_of(start=Start(x=[-0.05, 0.05], yaw=[-3.0, 3.0]))


@pytest.fixture(scope="module")
def episode(setup: Setup) -> Episode:
    return Episode(make_station(setup, "twin"))


def test_it_ends_when_the_object_rests(episode):
    episode.begin(Place(REST, np.zeros(3)), PUSH)
    times = list(episode.advance())
    record = episode.record
    assert times == pytest.approx(H * np.arange(len(times)), abs=1e-12)
    assert (record.t == times).all()
    assert record.at_rest
    assert PUSH.end_time + 0.1 <= record.t[-1] < PUSH.end_time + 0.3
    # Closed form: the gap of 10 mm, then with the pusher, whose last 2 mm the object does not follow but slides on.
    assert record.displacement[1] == pytest.approx(0.03 + 0.2**2 / (2 * 0.3 * 9.81) - 0.002, abs=5e-4)
    assert np.abs(record.displacement[[0, 2]]).max() < 1e-4
    assert record.rotation < 1e-3
    assert np.abs(record.pusher_state[-1] - [0, -0.035, 0.025, 0, 0, 0]).max() < 1e-9


def test_a_duration_ends_it_anywhere(episode):
    episode.begin(Place(REST, np.zeros(3)), PUSH)
    record = episode.run(0.2)
    assert record.t[-1] == pytest.approx(0.2)
    assert not record.at_rest
    episode.begin(Place(REST, np.zeros(3)), PUSH)
    assert len(episode.run(0.6).t) == 145  # goes on though the object rests


def test_a_new_start_forgets_the_last_push(episode):
    episode.begin(Place(REST, np.array([0.0, 0.3, 0.05])), PUSH)
    episode.run(0.1)
    episode.begin(Place(REST, np.array([0.0, 0.3, 0.05])))
    record = episode.run(0.1)
    assert (record.pusher_state == [0.0, 0.3, 0.05, 0, 0, 0]).all()
    assert np.abs(record.displacement).max() < 1e-4


def test_a_log_is_followed(setup, episode):
    episode.begin(Place(REST, np.zeros(3)), PUSH)
    first = episode.run()
    log = dataclasses.replace(first.trajectory(), t=first.t + 7.0)  # a clock of its own
    again = Episode(make_station(setup, "twin"), log)
    again.begin(Place(REST, np.zeros(3)))
    second = again.run()
    rows = min(len(first.t), len(second.t))
    assert np.abs(first.pusher_state[:rows, :3] - second.pusher_state[:rows, :3]).max() < 1e-12
    assert np.abs(first.object_state[:rows] - second.object_state[:rows]).max() < 1e-6


def test_a_place_is_drawn_by_the_station(episode):
    places = [episode.draw_place(RandomGenerator(seed)) for seed in (3, 3, 4)]
    assert places[0].X_WO.IsExactlyEqualTo(places[1].X_WO)
    assert (places[0].p_WP == places[1].p_WP).all()
    assert not places[0].X_WO.IsNearlyEqualTo(places[2].X_WO, 1e-3)


def test_one_script_is_for_one_world():
    with pytest.raises(ParameterError, match="num_worlds: got 2; allowed: 1"):
        Episode(make_station(setup_of(num_worlds=2), "twin"))


def test_pushes_stay_within_the_limits_and_meet_the_object(episode):
    low, high = [-0.14, -0.2, 0.01], [0.14, 0.2, 0.2]
    setup = setup_of(pusher=Pusher(max_speed=0.1, low=low, high=high))
    generator = np.random.default_rng(1)
    for _ in range(8):
        push = random_push(setup, REST, generator)
        ends = np.stack([push.p_WP, push.p_WP + push.distance * push.direction_W])
        assert (ends >= low).all()
        assert (ends <= high).all()
        assert push.speed <= 0.1
        assert push.p_WP[2] == setup.scenario.start.pusher_height
    episode.begin(Place(REST, np.zeros(3)), push)
    assert np.linalg.norm(episode.run().displacement) > 0.02
    with pytest.raises(ParameterError, match=r"pusher.low, pusher.high: got .*; allowed: a box with room"):
        random_push(setup_of(pusher=Pusher(low=[-0.05, -0.05, 0.0], high=[0.05, 0.05, 0.1])), REST, generator)


@pytest.mark.parametrize(
    ("shape", "height"),
    [
        (Shape("sphere", 0.01), 0.025),  # the centre of mass
        (Shape("cylinder", 0.01, 0.06), 0.034),  # 4 mm above the floor
        (Shape("capsule", 0.01, 0.06), 0.044),
    ],
)
def test_a_level_pusher_keeps_off_the_floor(shape, height):
    assert level_height(setup_of(pusher=Pusher(shape=shape))) == pytest.approx(height, abs=1e-6)
