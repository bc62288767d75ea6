# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import InputError, ModelError, StateError
from pinwm_drake.geometry.pieces import PROTRUSION
from pinwm_drake.geometry.stored_pieces import mesh_primitives
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.scene import (
    make_scene,
    pusher_motion,
    resting_height,
    rollout_poses,
    scaled_inertia,
    step_count,
)
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_exp

G, SIDE, SPEED = 9.81, 0.06, 0.2
PUSHER = PusherGeometry(None, PusherShape("sphere", 0.01))
LEVEL = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)


@pytest.fixture
def cube(tmp_path):
    trimesh.creation.box((SIDE, SIDE, SIDE)).export(tmp_path / "cube.obj")
    return tmp_path / "cube.obj"


def scene_of(path, **options):
    return make_scene(path, PUSHER, **({"q_WO": LEVEL, "gravity": G} | options))


def straight(seconds=1.0, stop=0.3, rows=41):
    """A push along x from 5 mm before the cube, which ends at once."""
    t = np.linspace(0.0, seconds, rows)
    p = np.tile([-SIDE / 2 - 0.015, 0.0, SIDE / 2], (rows, 1))
    p[:, 0] += SPEED * np.minimum(t, stop)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (rows, 1))
    return PusherTrajectory(t, p, q, np.gradient(p, t, axis=0), None)


@pytest.mark.parametrize("support", ["corners", "patch", "faces"])
def test_a_block_coasts_by_v2_over_2_mu_g(cube, support):
    scene = scene_of(cube, support=support)
    mu = 0.1
    start = Pose(LEVEL[None], torch.tensor([[0.0, 0.0, resting_height(scene, LEVEL)]], dtype=torch.float64))
    motion = pusher_motion(straight(), 0.0, 240, 1 / 240)
    parameters = Parameters.nominal(scene.model, friction_floor=mu, friction_pusher=0.0)
    X_WO = rollout_poses(scene, parameters, start, motion, torch.tensor([0.0, 0.3, 1.0], dtype=torch.float64))
    # The pusher reaches the block after 5 mm; when it stops, the block moves with its speed.
    pushed = SPEED * 0.3 - 0.005
    assert float(X_WO.p[1, 0, 0]) == pytest.approx(pushed, abs=2e-4)
    # First order in the step: v h / 2 = 0.4 mm.
    assert float(X_WO.p[2, 0, 0]) == pytest.approx(pushed + SPEED**2 / (2 * mu * G), abs=5e-4)
    assert float(X_WO.q[2, 0, 0]) == pytest.approx(1.0, abs=1e-5)


def test_a_patch_brakes_a_spin_as_uniform_pressure_does(cube):
    scene = scene_of(cube, support="patch")
    mu, spin, inertia = 0.2, 8.0, SIDE**2 / 6
    state = State.at_rest(scene.model, p_WB=(0, 0, resting_height(scene, LEVEL)), p_WP=(1.0, 0.0, 0.5))
    state.V_WB[0, 0, 2] = spin
    parameters = Parameters.nominal(scene.model, friction_floor=mu)
    T = 24
    record = Stepper(scene.model).rollout(parameters, state, torch.zeros(T, 1, 6, dtype=torch.float64))
    # Torque mu m g r with r the mean distance from the middle, side (sqrt 2 + asinh 1) / 6.
    slowing = mu * G * SIDE * (math.sqrt(2) + math.asinh(1)) / 6 / inertia
    # 32 directions hold back by at most 1 - cos(pi / 32) = 0.5 %; the points' radius is known to 1.8 %.
    assert spin - float(record.V_WB[-1, 0, 0, 2]) == pytest.approx(slowing * T / 240, rel=0.025)


def test_resting_height_touches_the_floor(cube):
    assert resting_height(scene_of(cube, support="corners"), LEVEL) == pytest.approx(SIDE / 2)
    turned = quaternion_exp(torch.tensor([0.0, math.pi / 4, 0.0], dtype=torch.float64))
    on_edge = scene_of(cube, support="corners", floor_height=0.1)
    assert resting_height(on_edge, turned) == pytest.approx(0.1 + SIDE / math.sqrt(2))


def test_motion_follows_the_log():
    log = straight(rows=7)
    motion = pusher_motion(log, 0.1, 90, 0.01)
    way = motion.p_WP + torch.cat([torch.zeros(1, 3), (0.01 * motion.V_WP[:, 3:]).cumsum(0)])
    times = 0.1 + 0.01 * np.arange(91)
    assert np.allclose(way[:, 0], np.interp(times, log.t, log.p_WP[:, 0]), atol=1e-12)
    assert (motion.V_WP[:, :3] == 0).all()


def test_motion_turns_with_the_log():
    t = np.array([0.0, 1.0])
    q = torch.stack([LEVEL, quaternion_exp(torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))]).numpy()
    log = PusherTrajectory(t, np.zeros((2, 3)), q, np.zeros((2, 3)), None)
    motion = pusher_motion(log, 0.0, 10, 0.1)
    assert np.allclose(motion.V_WP[:, 2], 1.0)


def test_poses_between_steps_lie_between_them(cube):
    scene = scene_of(cube, support="corners")
    start = Pose(LEVEL[None], torch.tensor([[0.0, 0.0, SIDE / 2]], dtype=torch.float64))
    motion = pusher_motion(straight(), 0.0, 60, 1 / 240)
    parameters = Parameters.nominal(scene.model)
    after = torch.tensor([20.0, 20.5, 21.0], dtype=torch.float64) / 240
    p = rollout_poses(scene, parameters, start, motion, after).p[:, 0, 0]
    assert float(p[1]) == pytest.approx(0.5 * float(p[0] + p[2]), abs=1e-12)


def test_a_time_after_the_motion_is_refused(cube):
    scene = scene_of(cube, support="corners")
    start = Pose(LEVEL[None], torch.tensor([[0.0, 0.0, SIDE / 2]], dtype=torch.float64))
    motion = pusher_motion(straight(), 0.0, 10, 1 / 240)
    with pytest.raises(StateError, match="allowed: 0 to"):
        rollout_poses(scene, Parameters.nominal(scene.model), start, motion, torch.tensor([0.5], dtype=torch.float64))


def test_wrong_options_are_refused(cube):
    with pytest.raises(ModelError, match="'corners', 'patch' or 'faces'"):
        scene_of(cube, support="edges")
    with pytest.raises(ModelError, match="neither a mesh nor a shape"):
        make_scene(cube, PusherGeometry(None, None), q_WO=LEVEL, gravity=G)


def test_a_broken_mesh_is_refused(cube, tmp_path):
    broken = tmp_path / "broken.obj"
    broken.write_bytes(cube.read_bytes()[:200])
    with pytest.raises(InputError, match=r"broken\.obj"):
        scene_of(broken)
    with pytest.raises(InputError, match=r"broken\.obj"):
        make_scene(cube, PusherGeometry(broken, None), q_WO=LEVEL, gravity=G)


def test_scaled_inertia_is_that_of_a_stretched_solid(cube):
    scene, mass = scene_of(cube, support="corners"), 0.7
    a, b, c = 0.5, 1.0, 1.7
    factors = torch.tensor([[1.0, 1.0, 1.0], [a**2, b**2, c**2]], dtype=torch.float64)
    uniform, stretched = scaled_inertia(scene, mass, factors)
    # m / 12 (b^2 + c^2) of a block.
    assert torch.allclose(uniform, mass * SIDE**2 / 6 * torch.eye(3, dtype=torch.float64), rtol=1e-6, atol=1e-12)
    block = torch.tensor([b**2 + c**2, a**2 + c**2, a**2 + b**2]).double().diag()
    assert torch.allclose(stretched, mass * SIDE**2 / 12 * block, rtol=1e-6, atol=1e-12)
    assert torch.autograd.gradcheck(lambda values: scaled_inertia(scene, mass, values), factors.requires_grad_())


@pytest.mark.parametrize(("seconds", "steps"), [(0.0, 1), (0.1, 10), (0.1 + 1e-10, 10), (0.1001, 11), (0.095, 10)])
def test_steps_cover_the_time(seconds, steps):
    assert step_count(seconds, 0.01) == steps


@pytest.mark.parametrize("support", ["corners", "patch", "faces"])
def test_mesh_that_acts_as_a_cylinder_rolls_on_and_its_facets_do_not(tmp_path, support):
    # v = w R stays; a prism loses (m r^2 / (I + m r^2)) (1 - cos(2 pi / n)) of it on each of its edges.
    radius, w = 0.04, 4.0
    trimesh.creation.cylinder(radius, 0.08, sections=64).export(tmp_path / "c.obj")
    lying = torch.tensor([0.5**0.5, 0.5**0.5, 0.0, 0.0], dtype=torch.float64)
    found = mesh_primitives(tmp_path / "c.obj")
    speeds = []
    for acts_as in (found, ()):
        scene = scene_of(tmp_path / "c.obj", q_WO=lying, support=support, acts_as=acts_as)
        height = resting_height(scene, lying)
        out = 0.0 if support == "corners" or not acts_as else PROTRUSION
        assert height == pytest.approx(radius + out, abs=1e-8)
        V_WB = torch.tensor([[[0.0, w, 0.0, w * radius, 0.0, 0.0]]], dtype=torch.float64)
        p_WB = torch.tensor([[[0.0, 0.0, height]]], dtype=torch.float64)
        far = torch.tensor([[1.0, 1.0, 1.0]], dtype=torch.float64)
        start = State(q_WB=lying[None, None], p_WB=p_WB, V_WB=V_WB, q_WP=LEVEL[None], p_WP=far)
        parameters = Parameters.nominal(scene.model, friction_floor=0.3, friction_pusher=0.3)
        motion = torch.zeros(240, 1, 6, dtype=torch.float64)
        record = Stepper(scene.model).rollout(parameters, start, motion)
        speeds.append(float(record.V_WB[-1, 0, 0, 1]))
        assert scene.model.bodies[0].inertia == pytest.approx(scene_of(tmp_path / "c.obj").model.bodies[0].inertia)
    assert speeds[0] == pytest.approx(w, rel=1e-3)
    assert speeds[1] < 0.95 * w


def test_resting_height_of_a_tilted_cylinder_is_that_of_its_rims(tmp_path):
    trimesh.creation.cylinder(0.04, 0.08, sections=64).export(tmp_path / "c.obj")
    scene = scene_of(tmp_path / "c.obj", support="corners", acts_as=mesh_primitives(tmp_path / "c.obj"))
    for tilt in (0.0, 0.1, 0.7, math.pi / 2):
        q = quaternion_exp(torch.tensor([0.6 * tilt, 0.8 * tilt, 0.0], dtype=torch.float64))
        height = 0.04 * math.cos(tilt) + 0.04 * math.sin(tilt)
        assert resting_height(scene, q) == pytest.approx(height, abs=1e-8)
