# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.systems.runs.realism.camera import moments
from pinwm_drake.systems.runs.realism.mistakes import late_log, moved_camera, moved_on_floor

X = RigidTransform(RollPitchYaw(0.3, -0.2, 1.0), [0.1, 0.2, 0.3])


def test_a_start_is_wrong_on_the_floor_by_as_much_as_it_says():
    generator = np.random.default_rng(0)
    moved = [moved_on_floor(X, 0.004, 0.05, generator) for _ in range(4000)]
    shifts = np.array([one.translation() - X.translation() for one in moved])
    assert shifts.std(axis=0) == pytest.approx([0.004, 0.004, 0.0], rel=0.05)
    turns = [one.rotation() @ X.rotation().inverse() for one in moved]
    # About the vertical alone.
    assert all(turn.matrix()[2, 2] == pytest.approx(1.0) for turn in turns)
    assert np.std([turn.ToRollPitchYaw().yaw_angle() for turn in turns]) == pytest.approx(0.05, rel=0.05)


def test_a_camera_is_wrong_by_as_much_as_it_says():
    generator = np.random.default_rng(0)
    moved = [moved_camera(X, 0.001, 0.002, generator) for _ in range(4000)]
    shifts = np.array([one.translation() - X.translation() for one in moved])
    assert shifts.std(axis=0) == pytest.approx([0.001] * 3, rel=0.05)
    turns = [RollPitchYaw(X.rotation().inverse() @ one.rotation()).vector() for one in moved]
    assert np.std(turns, axis=0) == pytest.approx([0.002] * 3, rel=0.05)


def test_a_late_log_says_later_what_was_and_covers_as_much():
    t = np.linspace(0.0, 1.0, 11)
    p = np.column_stack([t**2, 0 * t, 0 * t])
    q = np.tile([1.0, 0.0, 0.0, 0.0], (11, 1))
    log = late_log(PusherTrajectory(t, p, q, np.zeros((11, 3)), None), 0.02, 0.05)
    assert np.interp(0.5 + 0.02, log.t, log.p_WP[:, 0]) == pytest.approx(0.25)
    assert (log.t[0], log.t[-1]) == (pytest.approx(-0.03), pytest.approx(1.07))


def test_moments_lie_on_the_motion():
    t = np.linspace(0.0, 1.0, 101)
    poses = [RigidTransform(RollPitchYaw(0, 0, time), [time, 0, 0]) for time in t]
    p = np.column_stack([2 * t, 0 * t, 0 * t])
    at = np.array([0.333, 0.335, 0.3375])
    found, places = moments(t, poses, p, at)
    assert places[:, 0] == pytest.approx(2 * at)
    assert [X.translation()[0] for X in found] == pytest.approx(at)
    assert [X.rotation().ToRollPitchYaw().yaw_angle() for X in found] == pytest.approx(at)
    for ends in ([0.0, 0.0], [1.0, 1.0]):
        assert moments(t, poses, p, np.array(ends))[1][:, 0] == pytest.approx(2 * np.array(ends))
