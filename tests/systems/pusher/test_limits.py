# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.pusher.limits import PusherLimits, shortened
from tests.systems.pushers import PERIOD, Slider

LOW, HIGH = np.array([-0.2, -0.3, 0.01]), np.array([0.2, 0.3, 0.1])


def limited(v_WP, p_WP, max_speed=0.4):
    v_WP, p_WP = np.atleast_2d(v_WP).astype(float), np.atleast_2d(p_WP).astype(float)
    system = PusherLimits(len(v_WP), max_speed, LOW, HIGH, PERIOD)
    context = system.CreateDefaultContext()
    system.GetInputPort("pusher_velocity_W").FixValue(context, v_WP.ravel())
    # Velocities of the state are not looked at.
    system.GetInputPort("pusher_state").FixValue(context, np.hstack([p_WP, np.full_like(p_WP, 7.0)]).ravel())
    return system.get_output_port().Eval(context).reshape(-1, 3)


def test_speed_is_limited_and_direction_kept():
    middle = np.tile([0, 0, 0.05], (3, 1))
    v = limited([[0.6, -0.8, 0], [0.1, 0.2, 0.3], [-1e200, 1e200, 0]], middle)
    np.testing.assert_allclose(v[0], [0.24, -0.32, 0], rtol=1e-12)
    np.testing.assert_array_equal(v[1], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(v[2], np.array([-0.4, 0.4, 0]) / np.sqrt(2), rtol=1e-12)


def test_a_pusher_stops_exactly_at_a_wall_and_slides_along_it():
    builder = DiagramBuilder()
    limits = builder.AddSystem(PusherLimits(1, 0.4, LOW, HIGH, PERIOD))
    slider = builder.AddSystem(Slider([0.19, 0, 0.05]))
    builder.Connect(slider.get_output_port(), limits.GetInputPort("pusher_state"))
    builder.Connect(limits.get_output_port(), slider.get_input_port())
    builder.ExportInput(limits.GetInputPort("pusher_velocity_W"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.get_input_port().FixValue(context, [0.3, 0.1, -0.2])
    places = []
    for k in range(1, 100):
        simulator.AdvanceTo(k * PERIOD)
        places.append(slider.get_output_port().Eval(slider.GetMyContextFromRoot(context))[:3])
    places = np.array(places)
    assert places[:, 0].max() <= HIGH[0] + 1e-15
    np.testing.assert_allclose(places[-1], [0.2, 0.1 * 99 / 240, 0.01], atol=1e-12)
    # It goes on to the wall, 10 mm at 0.3 m/s, without slowing down before.
    np.testing.assert_allclose(places[:8, 0], 0.19 + 0.3 * PERIOD * np.arange(1, 9).clip(max=8), atol=1e-12)
    assert places[8, 0] == pytest.approx(0.2, abs=1e-12)


def test_outside_of_the_box_a_pusher_may_only_stay_or_come_back():
    v = limited([[0.1, -0.3, 0], [-0.1, 0.2, 0.0]], [[0.3, -0.5, 0.05], [0.3, -0.5, 0.05]])
    np.testing.assert_array_equal(v, [[0, 0, 0], [-0.1, 0.2, 0]])


@pytest.mark.filterwarnings("error")
def test_what_is_no_number_stands_still_and_leaves_other_worlds_alone():
    v_WP = [[np.nan, 0.1, 0], [np.inf, 0, 0], [0, 0, -np.inf], [0.1, 0, 0], [0.1, 0, 0], [0.1, 0, 0]]
    p_WP = [[0, 0, 0.05]] * 3 + [[0, np.nan, 0.05], [-np.inf, 0, 0.05], [0, 0, 0.05]]
    v = limited(v_WP, p_WP)
    np.testing.assert_array_equal(v, [[0, 0, 0]] * 5 + [[0.1, 0, 0]])


def test_speeds_within_the_limit_are_not_touched():
    vectors = np.random.default_rng(0).normal(size=(100, 3))
    np.testing.assert_array_equal(shortened(vectors, 10.0), vectors)
    short = shortened(vectors, 0.5)
    lengths = np.linalg.norm(vectors, axis=1)
    np.testing.assert_allclose(short, vectors * np.minimum(1, 0.5 / lengths)[:, None], rtol=1e-14)


def test_the_output_depends_on_both_inputs_at_once():
    system = PusherLimits(2, 0.4, LOW, HIGH, PERIOD)
    for port in ("pusher_velocity_W", "pusher_state"):
        assert system.HasDirectFeedthrough(system.GetInputPort(port).get_index(), 0)
    assert system.GetInputPort("pusher_state").size() == 12


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 0.4, LOW, HIGH, PERIOD), "num_worlds: got 0"),
        ((1, 0.0, LOW, HIGH, PERIOD), "max_speed: got 0; allowed: more than 0 m/s"),
        ((1, 0.4, HIGH, LOW, PERIOD), "pusher's box: got"),
        ((1, 0.4, LOW, [0.1, 0.1, np.nan], PERIOD), "pusher's box: got"),
        ((1, 0.4, LOW, HIGH, np.inf), "period: got inf"),
    ],
)
def test_numbers_out_of_range_are_named(arguments, message):
    with pytest.raises(ParameterError, match=message):
        PusherLimits(*arguments)
