# SPDX-License-Identifier: MIT
import dataclasses
import itertools
import math

import casadi as ca
import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.station_run import StationRun
from pinwm_drake.systems.mpc.model import SUB_STEPS, coast, coasting_time, planar_body, push_step, rotated
from pinwm_drake.systems.mpc.path import Detours
from pinwm_drake.systems.mpc.program import ACTIONS, GAP, PlannedPush, PushProgram
from pinwm_drake.systems.scenario.start import Place
from tests.systems.stations import action_setup

LONGEST = 0.03  # m in an action
HEIGHT = 0.025  # m, of the block's middle, and of the pusher
BAR_END, STEM_SIDE, STEM_END = 0, 3, 4  # edges of the T: the long side of the bar, a side of the stem, its end
STRAIGHT = np.array([1.0, 0.0])  # an action of full length along the normal


@pytest.fixture(scope="module")
def setup():
    return action_setup("push_t")


@pytest.fixture(scope="module")
def body(setup):
    return planar_body(setup)


@pytest.fixture(scope="module")
def program(body):
    return PushProgram(body, LONGEST, (0.02, 0.2))


@pytest.fixture(scope="module")
def detours(body):
    return Detours(body.outline, body.radius)


def object_state(pose, velocity=(0.0, 0.0, 0.0)):
    """(13,) of the block at x, y, yaw with their rates."""
    q_WO = RollPitchYaw(0.0, 0.0, pose[2]).ToQuaternion().wxyz()
    return np.array([*q_WO, pose[0], pose[1], HEIGHT, 0.0, 0.0, velocity[2], velocity[0], velocity[1], 0.0])


def evaluated(function, body, x):
    """What a function of the model makes of a planar state (6)."""
    return np.asarray(ca.DM(function(body, ca.DM(x))), float).ravel()


# The model.


def test_the_body_is_that_of_the_scene(body):
    assert body.turning == pytest.approx(
        (0.1 * 0.04 * (0.1**2 + 0.04**2) / 12 + 0.004 * 0.035**2) * 2 / 0.008, rel=1e-3
    )
    assert (body.radius, body.friction_floor, body.horizon) == (0.01, 0.03, 0.1)
    np.testing.assert_allclose(body.p_OB, 0.0, atol=1e-6)
    corners = {(-0.05, -0.055), (0.05, -0.055), (0.05, -0.015), (0.02, -0.015), (0.02, 0.085), (-0.02, 0.085)}
    corners |= {(-0.02, -0.015), (-0.05, -0.015)}
    assert {tuple(corner) for corner in body.outline.corners.round(6)} == corners


def test_a_planar_state_is_that_of_the_centre_of_mass(body):
    off = dataclasses.replace(body, p_OB=np.array([0.03, 0.0]))
    x = off.planar(object_state((0.1, 0.2, math.pi / 2), (0.0, 0.0, 2.0)))
    # 30 mm ahead along the world's y; it moves along -x.
    np.testing.assert_allclose(x, [0.1, 0.23, math.pi / 2, -0.06, 0.0, 2.0], atol=1e-12)


def test_a_sliding_object_stops_after_v_squared_over_two_mu_g(body):
    v, mu_g = 0.2, 0.03 * 9.81
    rest = evaluated(coast, body, [0.01, 0.02, 0.3, v, 0.0, 0.0])
    # `_SLOW`, 1 mm/s, is where friction is rounded off: less than a millimetre in v^2 / (2 mu g).
    np.testing.assert_allclose(rest, [0.01 + v**2 / (2 * mu_g), 0.02, 0.3], atol=1e-3)
    assert evaluated(coasting_time, body, [0, 0, 0, v, 0, 0])[0] == pytest.approx(v / mu_g, rel=1e-3)


def test_a_turning_object_stops_after_the_work_of_friction(body):
    turn = 4.0  # rad/s; I w^2 / 2 = mu m g lever angle
    angle = body.turning * turn**2 / (2 * body.braking * body.lever)
    rest = evaluated(coast, body, [0, 0, 0, 0, 0, turn])
    np.testing.assert_allclose(rest, [0.0, 0.0, angle], rtol=0.02, atol=1e-9)


@pytest.mark.parametrize("arm", [0.0, 0.03])
def test_contact_leaves_the_touched_point_as_fast_as_the_pusher(body, arm):
    touch = np.array([arm, -0.055 - body.radius])
    edge = ca.DM([*body.outline.corners[0], *body.outline.normals[0]])
    x, _ = push_step(body, ca.DM.zeros(6), ca.DM(touch), ca.DM([0.0, 0.2]), edge)
    v = np.asarray(ca.DM(x), float).ravel()[3:]
    # Of an impulse P along y at x = arm: v = P / m, w = P arm / I, with the pusher's friction of 0.03. Rounding of the
    # contact adds 5 um/s to 0.2 m/s.
    assert v[1] + arm * v[2] == pytest.approx(0.2, abs=1e-4)
    assert v[2] == pytest.approx(v[1] * arm / body.turning, rel=0.03, abs=1e-6)


# Long pushes, hits and oblique ones, which move the block by 15 to 210 mm and up to 0.9 rad. What they need: 2.4 mm and
# 0.046 rad, of sub-steps twice as long as the twin's and an ellipsoid for its limit surface.
PUSHES = [
    PlannedPush(BAR_END, 0.05, np.array([STRAIGHT, STRAIGHT, 0 * STRAIGHT])),
    PlannedPush(BAR_END, 0.075, np.array([0.7 * STRAIGHT, 0 * STRAIGHT, 0 * STRAIGHT])),
    PlannedPush(STEM_SIDE, 0.08, np.array([0.5 * STRAIGHT, [0.5, 0.1], 0 * STRAIGHT])),
    PlannedPush(STEM_END, 0.02, np.array([[0.6, 0.1], 0.6 * STRAIGHT, 0.6 * STRAIGHT])),
]


@pytest.mark.parametrize("push", PUSHES)
def test_a_push_leads_where_the_model_says(body, program, push):
    run, pose = StationRun(action_setup("push_t", time_step=1 / 120), "twin", None), np.array([0.03, -0.02, 0.6])
    p = program.start(pose, push)
    found = program.rest_after([*pose, 0, 0, 0], p, push.actions.ravel(), program.edge(push.edge))
    rest = np.asarray(found[0], float).ravel()
    run.place(Place(RigidTransform(RollPitchYaw(0, 0, pose[2]), [*pose[:2], HEIGHT]), np.array([*p, HEIGHT])))
    normal = rotated(body.outline.normals[push.edge], pose[2])
    for k in range(16):
        inward, along = push.actions[k] if k < ACTIONS else (0.0, 0.0)
        run.advance((along * rotated(normal, math.pi / 2) - inward * normal)[None])
    x = body.planar(run.object_state[0])
    assert np.abs(x[3:]).max() < 1e-3
    assert np.hypot(*(rest - pose)[:2]) > 0.014
    assert np.hypot(*(x[:2] - rest[:2])) < 4e-3
    assert abs(x[2] - rest[2]) < 0.08


# Outline and ways.


def test_distances_from_the_outline(body):
    points = np.array([[0.0, -0.075], [0.07, -0.035], [0.06, -0.065], [0.0, 0.0], [0.03, 0.0], [0.02, 0.095]])
    distance, out = body.outline.nearest(points)
    np.testing.assert_allclose(distance, [0.02, 0.02, 0.01 * math.sqrt(2), -0.02, 0.01, 0.01], atol=1e-7)
    np.testing.assert_allclose(out[[0, 1]], [[0.0, -1.0], [1.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1.0)
    further = body.outline.nearest(points + 1e-4 * out)[0]
    np.testing.assert_allclose(further[:5] - distance[:5], 1e-4, atol=1e-9)


def test_ways_lead_around_the_object(body, detours):
    outline = body.outline
    generator = np.random.default_rng(0)
    points = generator.uniform(-0.15, 0.15, (40, 2))
    points = points[outline.nearest(points)[0] > detours.clear]
    for start, end in itertools.pairwise(points):
        way = detours.way(start, end)
        assert (way[0] == start).all()
        assert (way[-1] == end).all()
        dense = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(way)])
        # Between samples, which are as far apart as the object is small, it may come nearer.
        assert outline.nearest(dense)[0].min() > detours.clear - 1e-3
        length = np.hypot(*np.diff(way, axis=0).T).sum()
        assert length == pytest.approx(detours.lengths(start[None], end[None])[0, 0], rel=1e-6)
        assert length >= np.hypot(*(end - start)) - 1e-9


def test_a_pusher_that_touches_goes_straight_out_first(body, detours):
    start = np.array([0.0, -0.055 - body.radius - 1e-4])
    way = detours.way(start, np.array([0.0, 0.15]))
    assert len(way) > 3
    np.testing.assert_allclose((way[1] - start)[0], 0.0, atol=1e-9)
    assert -0.055 - way[1][1] >= detours.clear


# The program.


def test_two_pushes_reach_the_goal_in_the_model(program):
    x = np.array([0.02, -0.08, 0.4, 0, 0, 0])
    pushes = (
        PlannedPush(BAR_END, 0.05, np.full((ACTIONS, 2), 0.3) * STRAIGHT),
        PlannedPush(STEM_END, 0.02, np.zeros((ACTIONS, 2))),
    )
    found = program.solve(x, None, pushes, np.zeros(3))
    begun = program.solve(x, program.start(x, found.pushes[0]), found.pushes, np.zeros(3))
    for solution in (found, begun):
        np.testing.assert_allclose(solution.rests[1], np.array([0.02, 0.02, 0.2]) * solution.error, atol=1e-9)
        assert solution.miss < 0.5
        for push in solution.pushes:
            assert (np.hypot(*push.actions.T) <= 1 + 1e-6).all()
    off = np.linalg.norm(program.start(x, found.pushes[0]) - x[:2] - rotated(np.array([0, -0.055]), 0.4))
    assert off >= GAP


def test_a_sub_step_is_a_part_of_an_action(body):
    x, p = push_step(body, ca.DM([0, 1, 0, 0, 0, 0]), ca.DM([0.0, -0.2]), ca.DM([0.3, 0.0]), ca.DM([0, 0, 0, -1.0]))
    np.testing.assert_allclose(np.asarray(p, float).ravel(), [0.03 / SUB_STEPS, -0.2], atol=1e-15)
    np.testing.assert_allclose(np.asarray(x, float).ravel(), [0, 1, 0, 0, 0, 0], atol=1e-6)


def test_a_pusher_above_the_object_is_refused(setup):
    start = dataclasses.replace(setup.scenario.start, pusher_height=0.06)
    high = dataclasses.replace(setup, scenario=dataclasses.replace(setup.scenario, start=start))
    with pytest.raises(ParameterError, match="pusher_height"):
        planar_body(high)
