# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.worlds import Worlds
from pinwm_drake.systems.mpc.sampling import carried_out, heading_turn
from pinwm_drake.systems.mpc.strokes import Strokes
from pinwm_drake.systems.scenario.start import StartDistribution

HORIZON, NUMBER = 9, 600


@pytest.fixture(scope="module")
def cube():
    """Worlds of a cube of 60 mm, and their middle start."""
    worlds = Worlds("flip_cube", "twin", NUMBER, EnvOptions(time_step=1 / 240))
    return worlds, StartDistribution(worlds.setup).middle()


@pytest.fixture(scope="module")
def strokes(cube):
    worlds, place = cube
    return Strokes(worlds, HORIZON).draw(np.random.default_rng(1), NUMBER, place.object_state, place.p_WP)


def test_they_meet_the_object_at_all_its_heights_and_stay_in_the_plane_of_the_heading(cube, strokes):
    worlds, place = cube
    assert strokes.shape == (NUMBER, HORIZON, 3)
    assert np.linalg.norm(strokes, axis=2).max() <= 1.0 + 1e-12
    assert not strokes[..., 1].any()
    longest = worlds.run.max_translation
    below = place.p_WP[2] + longest * strokes[:, 0, 2]  # the way to a height takes one action here
    pusher = worlds.setup.scenario.pusher
    assert below.min() == pytest.approx(pusher.low[2])
    assert np.ptp(below) > 0.04
    assert (strokes[:, 1, 0] < 0.0).mean() > 0.95  # towards the object
    assert (np.linalg.norm(strokes, axis=2) > 0.0).sum(1).max() <= 4


@pytest.mark.parametrize("farther", [0.0, 0.06])
def test_the_first_stroke_begins_just_before_the_face_wherever_the_pusher_is(cube, farther):
    worlds, place = cube
    p_WP = place.p_WP - np.array([farther, 0.0, 0.0])
    drawn = Strokes(worlds, HORIZON).draw(np.random.default_rng(2), 300, place.object_state, p_WP)
    assert np.linalg.norm(drawn[:, 0], axis=1).max() < 1.0  # the way takes one action
    # A plan's x is from the object to the pusher, which is -x of the world here.
    start = p_WP[0] - worlds.run.max_translation * drawn[:, 0, 0]
    gap = -0.03 - 0.01 - start  # half of the cube, and the pusher's radius
    assert -0.0101 <= gap.min() < -0.008
    assert 0.028 < gap.max() <= 0.0301


def test_some_of_them_turn_a_cube_over(cube, strokes):
    worlds, place = cube
    worlds.reset()
    worlds.set_object_states(np.tile(place.object_state, (NUMBER, 1)), np.tile(place.p_WP, (NUMBER, 1)))
    turn, over = heading_turn(worlds.task, place.object_state, place.p_WP), np.zeros(NUMBER, bool)
    for going, out in carried_out(worlds, strokes @ turn.T):
        over |= going & out.terminated
    assert over.sum() >= 60


def test_they_are_of_tasks_that_move_the_pusher_in_space(cube):
    assert Strokes.apply(cube[0])
    assert not Strokes.apply(Worlds("push_t"))


def test_a_pusher_of_limited_acceleration_gathers_speed_before_the_face():
    options = EnvOptions(time_step=1 / 240, acceleration=7.0)
    worlds = Worlds("flip_cube", "twin", 90, options)
    place = StartDistribution(worlds.setup).middle()
    found = Strokes(worlds, HORIZON)
    drawn = found.draw(np.random.default_rng(3), 90, place.object_state, place.p_WP)
    full = (drawn[:, :, 0] == -1.0).sum(1)
    assert set(full) == {0, 1, 2}
    worlds.reset()
    far = place.p_WP + np.array([-0.2, 0.0, 0.1])  # free of the object
    worlds.set_object_states(np.tile(place.object_state, (90, 1)), np.tile(far, (90, 1)))
    for number in (1, 2):
        worlds.advance(np.tile([1.0, 0.0, 0.0], (90, 1)))
        went = worlds.run.p_WP[0, 0] - far[0]
        assert went == pytest.approx(worlds.run.max_translation * found.gathered(number), rel=0.02)
