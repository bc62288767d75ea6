# SPDX-License-Identifier: MIT
"""Captures of the benchmark next_push: engines against closed forms, a small capture, and its mistakes."""

import dataclasses
import importlib.util
import math

import numpy as np
import pytest
import trimesh
from PIL import Image
from pydrake.math import RigidTransform

from benchmarks.next_push.captures import FIELD_OF_VIEW, episode_viewpoint, write_capture
from benchmarks.next_push.engines import engine
from benchmarks.next_push.engines.rollout import GRAVITY, LOG_RATE, Rollout, Theta, log_times
from benchmarks.next_push.jug import scanned_jug
from benchmarks.next_push.objects import OBJECTS, make_thing
from benchmarks.next_push.poses import PER_FRAME, pose_capture, read_poses, write_poses
from benchmarks.next_push.pushes import FRAME_RATE, Push, draw_pushes
from benchmarks.next_push.specification import CAPTURES, ENGINES, uneven
from pinwm_drake.capture.check import check_capture
from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import PusherShape, load_capture
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.occluder import mesh_depth
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.runs.realism.mistakes import Realism


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("objects")


def require_engine(name):
    module = {"mujoco": "mujoco", "bullet": "pybullet"}.get(name)
    if module is not None and importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed")
    return engine(name)


def central_push(thing, X_WO, speed, height):
    """Push along x through the middle of a cube's face."""
    start = X_WO.translation() - np.array([0.03 + 0.01 + 0.012, 0, 0])
    start[2] = height
    return Push(PusherShape("sphere", 0.01), StraightPush(start, np.array([1.0, 0, 0]), speed, 0.08, 10.0), 24)


def yaw(X):
    R = X.rotation().matrix()
    return math.atan2(R[1, 0], R[0, 0])


def test_there_are_six_objects_in_four_engines():
    assert len(CAPTURES) == len({spec.name for spec in CAPTURES}) == len({spec.seed for spec in CAPTURES}) == 24
    assert {(spec.thing, spec.engine) for spec in CAPTURES} == {(thing, name) for thing in OBJECTS for name in ENGINES}
    tuning = {spec.thing for spec in CAPTURES if spec.split == "tuning"}
    assert 0 < len(tuning) < len(OBJECTS)


@pytest.mark.parametrize("name", list(OBJECTS))
def test_objects_are_closed_and_their_pieces_fill_them(name, folder):
    thing = make_thing(name, folder)
    mesh = thing.mesh()
    assert mesh.is_watertight
    points = np.concatenate(thing.hulls)
    # Coordinates in files have nine digits.
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], mesh.bounds, atol=1e-8)
    # Normals of the base point down: the object stands on it.
    assert thing.base_points()[:, 2].max() < mesh.bounds[0, 2] + 0.002


@pytest.mark.nightly
@pytest.mark.parametrize("name", ENGINES)
def test_a_cube_stands_still_and_slides_as_far_as_friction_lets_it(name, folder):
    roll_out, cube = require_engine(name), make_thing("cube", folder)
    mass, friction, speed = 0.5, 0.1, 0.3
    theta = Theta(mass, friction, 0.3, np.zeros(3), mass * 0.06**2 / 6 * np.eye(3), np.zeros((0, 3)))
    X_WO = roll_out(cube, theta, RigidTransform([0, 0, 0.03]), None, np.array([0.0, 0.5])).X_WO[-1]
    still = roll_out(cube, theta, X_WO, None, np.array([0.0, 1.0])).X_WO[-1]
    assert np.linalg.norm(still.translation() - X_WO.translation()) < 1e-5
    push = central_push(cube, X_WO, speed, 0.02)
    rollout = roll_out(cube, theta, X_WO, push, log_times(24, FRAME_RATE))
    wanted = np.array([push.motion.p_WP + push.motion.travel(t)[0] * push.motion.direction_W for t in rollout.t])
    assert np.abs(rollout.p_WP - wanted).max() < 1e-5
    # Pushed, the cube is as fast as the pusher; from where it stops, it slides on by v^2 / 2 mu g.
    stops = push.motion.end_time - push.motion.speed / push.motion.acceleration
    x = np.array([X.translation()[0] for X in rollout.X_WO])
    k = math.floor(stops * LOG_RATE)
    assert (x[k] - x[k - 12]) * LOG_RATE / 12 == pytest.approx(speed, rel=0.01)
    left = x[k] + speed * (stops - k / LOG_RATE)
    assert x[-1] - left == pytest.approx(speed**2 / (2 * friction * GRAVITY), rel=0.04)
    assert abs(yaw(rollout.X_WO[-1])) < math.radians(0.5)


@pytest.mark.parametrize("name", ["t", "jug"])
def test_pushes_go_to_different_sides_at_speeds_that_know_no_friction(name, folder):
    mesh = make_thing(name, folder).mesh()
    mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
    pushes = draw_pushes(mesh, PusherShape("sphere", 0.01), np.random.default_rng(3))
    angles = np.sort([math.atan2(push.motion.direction_W[1], push.motion.direction_W[0]) for push in pushes])
    assert np.diff([*angles, angles[0] + 2 * math.pi]).min() > math.radians(15)
    for push in pushes:
        assert 0.05 <= push.motion.speed <= 0.3
        assert 32 <= push.frames <= 48
        # The video goes on after the pusher has stopped.
        assert push.motion.end_time < (push.frames - 1) / FRAME_RATE - 0.1


@pytest.mark.parametrize("name", list(OBJECTS))
def test_an_uneven_object_is_a_possible_one(name, folder):
    thing = make_thing(name, folder)
    spec = next(spec for spec in CAPTURES if spec.thing == name)
    even = spec.theta(thing)
    for seed in range(5):
        theta = uneven(thing, even, np.random.default_rng(seed))
        off = np.linalg.norm(theta.p_com - even.p_com) / thing.mesh().extents.mean()
        assert 0.015 < off < 0.095
        moments = np.linalg.eigvalsh(theta.inertia)
        assert moments[0] > 0
        assert moments[2] < moments[0] + moments[1]
        assert len(theta.feet) in (3, 4)
        assert theta.feet[:, 2].max() < thing.mesh().bounds[0, 2]
        assert (theta.mass, theta.friction_floor) == (even.mass, even.friction_floor)


@pytest.fixture(scope="module")
def posed(folder):
    """Cube pushed once in the engine of points, its first eight pictures."""
    thing, spec = make_thing("cube", folder), next(spec for spec in CAPTURES if spec.name == "cube_point")
    theta = uneven(thing, spec.theta(thing), np.random.default_rng(1))
    made = pose_capture(spec, thing, theta, number=1)
    push, rollout = made.pushes[0], made.rollouts[0]
    # The end of the push, where both are moving and the pusher comes to rest.
    last = math.ceil(push.motion.end_time * FRAME_RATE) + 2
    rows = np.arange((last + 1) * PER_FRAME + 1)
    short = Rollout(rollout.t[rows], [rollout.X_WO[k] for k in rows], rollout.p_WP[rows])
    return spec, thing, dataclasses.replace(made, rollouts=[short])


@pytest.mark.nightly
def test_poses_survive_their_file(posed, tmp_path):
    spec, thing, made = posed
    write_poses(tmp_path / "poses.npz", spec, thing, made)
    read = read_poses(tmp_path / "poses.npz")
    assert read.pushes[0].shape == made.pushes[0].shape
    np.testing.assert_array_equal(read.pushes[0].motion.to_vector(), made.pushes[0].motion.to_vector())
    np.testing.assert_array_equal(read.rollouts[0].p_WP, made.rollouts[0].p_WP)
    for one, other in zip(read.rollouts[0].X_WO, made.rollouts[0].X_WO, strict=True):
        np.testing.assert_allclose(one.GetAsMatrix4(), other.GetAsMatrix4(), atol=1e-12)
    for field in dataclasses.fields(Theta):
        np.testing.assert_array_equal(getattr(read.theta, field.name), getattr(made.theta, field.name))


def silhouette(mesh, X_WO, X_WC, camera):
    """Mask (H, W) of a mesh without what hides it."""
    X_CO = X_WC.inverse() @ X_WO
    corners = mesh.vertices @ X_CO.rotation().matrix().T + X_CO.translation()
    return np.isfinite(mesh_depth(corners[None], np.asarray(mesh.faces), camera, 1e-3)[0])


@pytest.mark.nightly
def test_a_clean_capture_shows_the_poses_and_can_be_read(posed, tmp_path):
    spec, thing, made = posed
    write_capture(tmp_path / "clean", spec, thing, made, pixels=96, views=8)
    capture = load_capture(tmp_path / "clean")
    assert capture.episode_names == ["0000"]
    assert capture.pusher.shape == spec.shape
    np.testing.assert_allclose(capture.object.X_WO.p.numpy(), made.X_WO.translation(), atol=1e-12)
    episode = read_episode(capture, "0000")
    np.testing.assert_allclose(episode.trajectory.p_WP, made.rollouts[0].p_WP, atol=1e-12)
    assert not check_capture(tmp_path / "clean").problems
    X_WC = episode_viewpoint(spec, thing, made, 0)
    camera = Camera.from_field_of_view(96, 96, FIELD_OF_VIEW)
    for k in (0, len(episode.t) - 1):
        picture = np.array(Image.open(tmp_path / f"clean/episodes/0000/rgb/{k:05d}.png"))
        mask = picture[..., 3] > 0
        whole = silhouette(thing.mesh(), made.rollouts[0].X_WO[k * PER_FRAME], X_WC, camera)
        # Half a pixel along the outline; the pusher hides some of the object, and nothing adds to it.
        assert (mask & ~whole).sum() < 0.02 * whole.sum()
        assert 0.75 * whole.sum() < mask.sum()


@pytest.mark.nightly
def test_a_realistic_capture_is_wrong_as_it_says(posed, tmp_path):
    spec, thing, made = posed
    mistakes = write_capture(tmp_path / "realistic", spec, thing, made, Realism(), pixels=96, views=8)
    capture = load_capture(tmp_path / "realistic")
    shift = capture.object.X_WO.p.numpy() - made.X_WO.translation()
    np.testing.assert_allclose(shift, mistakes["start_shift"], atol=1e-12)
    assert 0 < np.linalg.norm(shift) < 0.03
    episode = read_episode(capture, "0000")
    late = mistakes["episodes"][0]["log_late"]
    log = episode.trajectory
    # The log says p at t + late where the camera would have said p at t.
    for t in (0.1, 0.2):
        place = [np.interp(t + late, log.t, log.p_WP[:, k]) for k in range(3)]
        wanted = made.pushes[0].motion.p_WP + made.pushes[0].motion.travel(t)[0] * made.pushes[0].motion.direction_W
        np.testing.assert_allclose(place, wanted, atol=1e-4)
    assert abs(late) <= 0.03
    picture = np.array(Image.open(tmp_path / "realistic/static/images/00000.png"))
    assert picture.shape == (96, 96, 4)
    assert set(np.unique(picture[..., 3])) == {0, 255}


def test_the_scanned_jug_is_one_closed_surface_with_a_hole():
    corners, triangles = scanned_jug()
    again, _ = scanned_jug()
    np.testing.assert_array_equal(corners, again)
    mesh = trimesh.Trimesh(corners, triangles, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.euler_number == 0  # a torus has one hole: that of the handle
    assert 2000 <= len(triangles) <= 4000
