import math

import numpy as np
import pytest
import torch
import trimesh
from pydrake.math import RotationMatrix

from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.systems.scenario.exploring import ExploringStarts
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.start import StartDistribution


def tilt(place, up):
    return math.acos(np.clip((place.X_WO.rotation().matrix() @ up)[2], -1.0, 1.0))


@pytest.fixture(scope="module", params=["flip_mug", "flip_cube"])
def scene(request):
    setup = load_setup(request.param)
    starts, generator = ExploringStarts(setup), np.random.default_rng(3)
    return setup, [starts.draw(generator) for _ in range(120)]


def test_objects_lie_or_stand_on_an_edge_turned_by_up_to_a_share_of_the_way(scene):
    setup, places = scene
    vertices = load_mesh(setup.twin.mesh_path).vertices
    for place in places:
        lowest = (place.X_WO @ vertices.T)[2].min()
        assert 0.0 < lowest < 1e-3
    tilts = np.array([tilt(place, np.array(setup.task.up)) for place in places])
    assert np.histogram(tilts, bins=[0.6, 0.95, 1.25, 1.56])[0].min() > 12
    lying = np.abs(tilts - 0.5 * math.pi) < 1e-6
    assert 30 < lying.sum() < 70
    assert tilts.min() >= 0.4 * 0.5 * math.pi


def test_pushers_touch_nothing_and_stay_in_their_box(scene):
    setup, places = scene
    limits, radius = setup.scenario.pusher, setup.twin.pusher.shape.radius
    points = trimesh.sample.sample_surface(load_mesh(setup.twin.mesh_path), 20_000, seed=0)[0]
    for place in places:
        assert (place.p_WP >= limits.low).all()
        assert (place.p_WP <= limits.high).all()
        assert np.linalg.norm(points - place.X_WO.inverse() @ place.p_WP, axis=1).min() > radius
    sides = np.array([place.p_WP - place.X_WO.translation() for place in places])
    assert min((sides[:, 0] > 0.02).sum(), (sides[:, 0] < -0.02).sum(), (sides[:, 2] > 0.05).sum()) > 10


def test_starts_of_a_task_that_knows_no_way_are_those_of_the_scene():
    setup = load_setup("push_t")
    exploring, usual = ExploringStarts(setup), StartDistribution(setup)
    for seed in range(4):
        place, wanted = (one.draw(np.random.default_rng(seed)) for one in (exploring, usual))
        assert place.X_WO.IsExactlyEqualTo(wanted.X_WO)
        assert np.array_equal(place.p_WP, wanted.p_WP)


def test_a_share_of_the_way_turns_by_that_share_and_by_nothing_else(scene):
    setup = scene[0]
    up = np.array(setup.task.up)
    R_WO = StartDistribution(setup).draw(np.random.default_rng(1)).X_WO.rotation()
    for share in (0.0, 0.3, 1.0, 1.05):
        q_WO = setup.task.nearer(R_WO.ToQuaternion().wxyz(), share)
        R_W = turned(q_WO) @ R_WO.matrix().T
        way = math.acos((R_WO.matrix() @ up)[2])
        assert abs((turned(q_WO) @ up)[2] - math.cos((1.0 - share) * way)) < 1e-9
        # The axis of the turn is level: nothing is turned about the vertical.
        assert abs(R_W[0, 1] - R_W[1, 0]) < 1e-9


def turned(q_WO):
    w, x, y, z = q_WO
    from pydrake.common.eigen_geometry import Quaternion

    return RotationMatrix(Quaternion(w, x, y, z)).matrix()


def test_an_object_that_is_upside_down_has_a_way_too():
    task = load_setup("flip_cube").task
    over = np.array([math.cos(-math.pi / 4), 0.0, math.sin(-math.pi / 4), 0.0])  # -x to -z
    assert torch.isfinite(torch.tensor(task.nearer(over, 0.5))).all()
    assert (turned(task.nearer(over, 1.0)) @ task.up)[2] == pytest.approx(1.0)
