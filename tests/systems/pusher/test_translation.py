# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.pusher.translation import PusherTranslation
from pinwm_drake.systems.scenario.schema import Pusher, Scenario
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import make_station
from tests.systems.pushers import PERIOD, Track

H, N = 0.1, 24


def track(limit=0.03, num_worlds=1):
    system = PusherTranslation(num_worlds, H, limit, PERIOD)
    return Track(system, np.zeros((num_worlds, 3)))


def test_a_translation_is_done_within_its_horizon_and_not_later():
    steps = track()
    actions = np.random.default_rng(0).uniform(-0.015, 0.015, (50, 3))
    actions[0] = [0.02, 0, 0]
    done = np.zeros(3)
    for k, d in enumerate(actions):
        steps.fix(d)
        # On the way at an even speed: half of it after half of the horizon.
        half = steps.position((k * N + N // 2) * PERIOD)[0]
        np.testing.assert_allclose(half, done + 0.5 * d, atol=1e-12)
        steps.fix([np.nan] * 3)  # held: nobody looks at the input between samples
        done = done + d
        np.testing.assert_allclose(steps.position((k + 1) * N * PERIOD)[0], done, atol=1e-12)


def test_worlds_are_moved_each_by_its_own():
    steps = track(num_worlds=3)
    d = np.array([[0.01, 0, 0], [0, -0.02, 0.005], [0, 0, 0]])
    steps.fix(d)
    np.testing.assert_allclose(steps.position(N * PERIOD), d, atol=1e-12)


@pytest.mark.parametrize(("engine", "accuracy"), [("twin", 1e-14), ("hydroelastic", 1e-8), ("point", 1e-8)])
def test_translations_are_on_time_in_every_engine(engine, accuracy):
    # In plants, a drive of finite stiffness has to speed the pusher up: measured 3e-9 m.
    station = make_station(Scenario(object="cube", pusher=Pusher(max_speed=0.3)), engine, command="translation")
    context = station.CreateDefaultContext()
    station.SetPlace(context, Place(RigidTransform([0, 0, 0.03]), np.array([0.2, 0.1, 0.05])))
    simulator, period = Simulator(station, context), station.setup.period
    pusher = station.GetOutputPort("pusher_state")
    for k, d in enumerate([[0.02, 0, 0], [0, -0.03, 0], [0.06, 0.08, 0], [0, 0, 0]]):
        before = pusher.Eval(context)[:3]
        station.GetInputPort("pusher_translation_W").FixValue(context, d)
        simulator.AdvanceTo((k + 1) * N * period)
        # No longer than 0.3 m/s x 0.1 s.
        expected = np.array(d) * (0.3 if k == 2 else 1.0)
        np.testing.assert_allclose(pusher.Eval(context)[:3] - before, expected, atol=accuracy)


def test_long_translations_are_shortened_and_wrong_ones_are_none():
    steps = track(0.02, 5)
    steps.fix([[0.03, -0.04, 0], [0.012, 0.016, 0], [np.nan, 0.01, 0], [0.01, np.inf, 0], [-1e300, 0, 0]])
    expected = [[0.012, -0.016, 0], [0.012, 0.016, 0], [0, 0, 0], [0, 0, 0], [-0.02, 0, 0]]
    np.testing.assert_allclose(steps.position(N * PERIOD), expected, atol=1e-12)


def test_a_context_that_is_copied_in_the_middle_goes_on_the_same():
    steps = track()
    steps.fix([0.02, 0.01, 0])
    steps.position(30 * PERIOD)
    copy = Simulator(steps.diagram, steps.context.Clone())
    # The sample at 24 periods is in the state; the one at 48 is taken from the copied input.
    for simulator in (steps.simulator, copy):
        simulator.AdvanceTo(60 * PERIOD)
    states = [steps.diagram.get_output_port().Eval(s.get_context()) for s in (steps.simulator, copy)]
    np.testing.assert_array_equal(*states)
    assert states[0][0] == pytest.approx(0.02 * 60 / 24)


def test_the_velocity_is_no_feedthrough():
    system = PusherTranslation(1, H, 0.03, PERIOD)
    assert not system.HasAnyDirectFeedthrough()
    assert system.num_continuous_states() == 0
    assert system.get_output_port().size() == system.get_input_port().size() == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 0.1, 0.03), "num_worlds: got 0"),
        ((1, np.nan, 0.03), "horizon: got nan"),
        ((1, 0.1, -1.0), "max_translation: got -1"),
        ((1, 0.1, 0.03, 0.03), r"horizon: got 0\.1 s; allowed: a whole multiple of the period, 0\.03 s"),
        ((1, 0.1, 0.03, 0.0), "the period: got 0"),
    ],
)
def test_numbers_out_of_range_are_named(arguments, message):
    with pytest.raises(ParameterError, match=message):
        PusherTranslation(*arguments)
