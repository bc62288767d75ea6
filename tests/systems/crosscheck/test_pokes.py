# SPDX-License-Identifier: MIT
import dataclasses
import math
from typing import get_args, get_type_hints

import numpy as np
import pytest
import trimesh
from pydrake.math import RotationMatrix

from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.systems.crosscheck.crosscheck import CHECKS, crosscheck
from pinwm_drake.systems.crosscheck.motion import SLIDING, Motion, unlimited
from pinwm_drake.systems.crosscheck.options import CrossCheckOptions
from pinwm_drake.systems.crosscheck.pokes import PokeCheck, draw_pokes, judge
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.tasks.recipe import Recipe


def motion_of(roll, yaw=0.0, x=0.0, failure=""):
    """An object that lies rolled about x and turned about z in the end, and is at x [m] as the pusher stops."""
    R_WO = RotationMatrix.MakeZRotation(yaw) @ RotationMatrix.MakeXRotation(roll)
    q = np.stack([[1.0, 0, 0, 0], [1.0, 0, 0, 0], R_WO.ToQuaternion().wxyz()])
    p, modes = np.array([[0.0, 0, 0], [x, 0, 0], [x, 0, 0]]), np.full(3, SLIDING)
    return Motion(np.arange(3.0), p, q, np.zeros((3, 3)), np.zeros(3), np.zeros(3), modes, modes, 1, 2, failure)


def test_the_face_is_what_is_up_whatever_the_yaw():
    quarter = math.pi / 2
    pokes = [
        {"twin": motion_of(0.0), "hydroelastic": motion_of(0.0, yaw=2.0), "point": motion_of(0.1)},
        {"twin": motion_of(quarter), "hydroelastic": motion_of(0.0), "point": motion_of(0.0)},
        {"twin": motion_of(quarter), "hydroelastic": motion_of(quarter, yaw=1.0), "point": motion_of(0.0)},
        # No majority among three faces.
        {"twin": motion_of(quarter), "hydroelastic": motion_of(0.0), "point": motion_of(-quarter)},
    ]
    assert [one.other_face for one in judge(pokes, ("hydroelastic", "point"))] == [1, 0, 1]


def test_differences_are_those_at_the_pushers_stop_and_failures_are_counted():
    pokes = [
        {"twin": motion_of(0.0), "point": motion_of(0.0, x=x, failure=failure)}
        for x, failure in ((0.001, ""), (0.002, ""), (0.009, ""), (1.0, "SolverError"))
    ]
    twin, point = judge(pokes, ("point",))
    assert twin.translation == (0.0, 0.0)
    assert point.translation[0] == pytest.approx(0.002)
    assert point.rotation == (0.0, 0.0)
    assert (twin.failed, point.failed, point.other_face) == (0, 1, 0)
    assert PokeCheck([None] * 4, pokes, [twin, point]).passed
    for wrong in ({"translation": (0.015, 0.02)}, {"rotation": (0.16, 0.2)}):
        assert not PokeCheck([None] * 4, pokes, [twin, dataclasses.replace(point, **wrong)]).passed
    assert not PokeCheck([None] * 4, pokes, [dataclasses.replace(twin, other_face=1), point]).passed
    lines = PokeCheck([None] * 4, pokes, [twin, point]).words()
    assert "after 0 of 4 pokes; from the twin at the pusher's stop 2.0 mm, 0.00 rad" in lines[1]
    assert lines[1].endswith("gave up in 1")


@pytest.fixture(scope="module")
def cube():
    return load_setup("flip_cube")


def test_pokes_start_clear_of_the_object_and_go_up(cube):
    trials = draw_pokes(unlimited(cube), 3, 5)
    points = trimesh.sample.sample_surface(load_mesh(cube.twin.mesh_path), 20000, seed=0)[0]
    for trial in trials:
        push = trial.push
        surface = points @ trial.X_WO.rotation().matrix().T + trial.X_WO.translation()
        gap = np.linalg.norm(surface - push.p_WP, axis=1).min() - cube.twin.pusher.shape.radius
        assert 1e-3 < gap < 6e-3
        assert 0.6 <= push.speed <= 1.0
        assert 0.3 <= math.asin(push.direction_W[2]) <= 1.1
        assert np.linalg.norm(push.direction_W) == pytest.approx(1.0)
        assert push.p_WP[2] > cube.twin.pusher.shape.radius
    again = draw_pokes(unlimited(cube), 1, 5)[0]
    np.testing.assert_array_equal(again.push.to_vector(), trials[0].push.to_vector())


def test_every_check_that_a_recipe_may_name_is_there():
    assert set(CHECKS) == set(get_args(get_type_hints(Recipe)["check"]))


@pytest.mark.nightly
def test_a_poked_cube_moves_alike_in_point_contact(cube):
    seen = []
    found = crosscheck(cube, CrossCheckOptions(engines=("point",), pushes=3), report=lambda: seen.append(1))
    assert len(seen) == 3
    assert [one.engine for one in found.verdicts] == ["twin", "point"]
    point = found.verdicts[1]
    # Measured over twelve: 0.7 mm and 0.02 rad.
    assert point.translation[0] < 3e-3
    assert point.rotation[0] < 0.08
