# SPDX-License-Identifier: MIT
"""Identification in the plane."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from pinwm_drake.capture.episodes import ObjectPoses, PusherTrajectory, read_episode
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.baselines.planar.body import make_planar_body
from pinwm_drake.paper.baselines.planar.identify import PlanarOptions, PlanarProperties, identify_planar, planar_twin
from pinwm_drake.paper.baselines.planar.rollout import PlanarParameters, PlanarPush, rollout
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.origin import identified_push, start_pose
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.rollout import twin_parameters, twin_scene
from pinwm_drake.twin.write import write_twin
from tests.capture.pushed_cube import write_pushed_cube
from tests.paper.baselines.planar.shapes import t_body
from tests.rendering.scenes import cloud

RADIUS, MASS, FLOOR, PUSHER = 0.01, 0.7, 0.08, 0.2
# Two pushes at the two arms of the T, one after the other.
TIMES = np.array([0.0, 0.5, 0.75, 1.0, 1.6])
PLACES = np.array([[0.03, -0.07], [0.03, 0.0], [0.03, -0.08], [-0.04, -0.08], [-0.04, 0.0]])
OPTIONS = PlanarOptions(starts=2, iterations=100, noise=1e-4)


def trajectory() -> PusherTrajectory:
    t = np.linspace(0.0, 1.6, 193)
    p_WP = np.stack([*(np.interp(t, TIMES, PLACES[:, axis]) for axis in range(2)), 0.0 * t], axis=-1)
    return PusherTrajectory(t, p_WP, np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)), np.zeros((len(t), 3)), None)


def heavy_at_the_stem(body, friction_pusher=PUSHER) -> PlanarParameters:
    """Cells that grow heavier along y."""
    mass = torch.exp(8.0 * body.cells[:, 1])
    return PlanarParameters(
        (MASS * mass / mass.sum())[None],
        torch.full((1, len(body.cells)), FLOOR).double(),
        torch.tensor([friction_pusher]).double(),
    )


def recorded(body, friction_pusher=PUSHER) -> ObjectPoses:
    """Poses that the simulator itself makes, 30 a second."""
    pusher, h = trajectory(), 1.0 / 240.0
    steps = h * np.arange(385)
    path = np.stack([np.interp(steps, pusher.t, pusher.p_WP[:, axis]) for axis in range(2)], axis=-1)
    start = torch.tensor([[0.0, 0.0, 0.2]]).double()
    found = rollout(
        body, heavy_at_the_stem(body, friction_pusher), start, PlanarPush(torch.from_numpy(path), RADIUS, h)
    )
    x, y, yaw = found[::8, 0].numpy().T
    q_WO = np.stack([np.cos(yaw / 2), 0.0 * yaw, 0.0 * yaw, np.sin(yaw / 2)], axis=-1)
    return ObjectPoses(steps[::8], np.stack([x, y, 0.0 * x], axis=-1), q_WO)


@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    body = t_body(tmp_path_factory.mktemp("t"))
    return body, recorded(body)


@pytest.mark.nightly
def test_friction_and_centre_of_mass_are_found_again(pushed):
    body, poses = pushed
    found = identify_planar(body, poses, trajectory(), RADIUS, mass=MASS, options=OPTIONS)
    true = heavy_at_the_stem(body).sliding(body, 9.81)
    even = float(body.cells[:, 1].mean())
    assert found.error < 3e-4
    assert found.properties.mass == pytest.approx(MASS)
    assert found.properties.friction_floor == pytest.approx(FLOOR, rel=0.1)
    assert found.properties.friction_pusher == pytest.approx(PUSHER, rel=0.3)
    # The pushes tell where the load is, which the prior takes for mass in part only: the way to the truth is begun.
    off = np.subtract(found.properties.center, true.center[0].numpy())
    moved = float(true.center[0, 1]) - even
    assert moved > 0.01
    assert found.properties.center[1] - even > 0.3 * moved
    assert np.linalg.norm(off) < 0.7 * moved
    assert found.properties.inertia == pytest.approx(float(true.inertia), rel=0.15)
    assert found.cells.shape == (len(body.cells), 2)
    assert found.cells[:, 0].sum() == pytest.approx(MASS)
    assert ((found.cells[:, 1] >= 0.005) & (found.cells[:, 1] <= 0.5)).all()
    assert found.poses.shape == (len(poses.t), 3)
    assert len(found.losses) == 2


def test_a_friction_is_looked_for_in_the_range_that_is_given(pushed):
    body, _ = pushed
    poses = recorded(body, 0.9)
    usual, wide = (
        identify_planar(
            body,
            poses,
            trajectory(),
            RADIUS,
            mass=MASS,
            options=replace(OPTIONS, starts=1, iterations=number, friction=ends),
        )
        for number, ends in ((15, (0.005, 0.5)), (60, (0.05, 1.0)))
    )
    assert usual.properties.friction_pusher < 0.5
    assert wide.properties.friction_pusher == pytest.approx(0.9, rel=0.2)
    assert wide.losses[0] < usual.losses[0]


def test_the_same_again_gives_the_same(pushed):
    body, poses = pushed
    options = replace(OPTIONS, starts=3, iterations=3, seed=4)
    once, again = (identify_planar(body, poses, trajectory(), RADIUS, options=options) for _ in range(2))
    assert once.properties == again.properties
    assert np.array_equal(once.losses, again.losses)
    other = identify_planar(body, poses, trajectory(), RADIUS, options=replace(options, seed=5))
    assert once.losses[0] == other.losses[0]  # the middle of the bounds
    assert once.losses[1] != other.losses[1]


def test_a_longer_search_is_no_worse(pushed):
    body, poses = pushed
    losses = [
        identify_planar(body, poses, trajectory(), RADIUS, options=replace(OPTIONS, starts=1, iterations=n)).losses[0]
        for n in (1, 12)
    ]
    assert losses[1] < 0.2 * losses[0]


def test_times_count_from_the_first_pose(pushed):
    body, poses = pushed
    options = replace(OPTIONS, starts=1, iterations=2)
    later = ObjectPoses(poses.t + 5.0, poses.p_WO, poses.q_WO)
    pusher = replace(trajectory(), t=trajectory().t + 5.0)
    one = identify_planar(body, poses, trajectory(), RADIUS, options=options)
    two = identify_planar(body, later, pusher, RADIUS, options=options)
    np.testing.assert_allclose(one.poses, two.poses, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("starts", 0),
        ("iterations", 0),
        ("rate", 0.0),
        ("noise", -1.0),
        ("spread_mass", math.nan),
        ("spread_friction", 0.0),
        ("smoothness", 0.0),
        ("time_step", 0.0),
        ("seed", -1),
        ("friction", (0.5, 0.5)),
        ("friction", (0.0, 0.5)),
        ("friction", (0.1, math.inf)),
    ],
)
def test_bad_options_are_refused(name, value):
    with pytest.raises(ParameterError, match=re.escape(f"{name}: got {value}; allowed")):
        PlanarOptions(**{name: value})


def test_bad_inputs_are_refused(pushed):
    body, poses = pushed
    with pytest.raises(ParameterError, match=r"mass: got 7\.0; allowed: 0\.2 to 5 kg"):
        identify_planar(body, poses, trajectory(), RADIUS, mass=7.0)
    for wrong in (
        ObjectPoses(poses.t[:1], poses.p_WO[:1], poses.q_WO[:1]),
        ObjectPoses(poses.t, poses.p_WO * math.nan, poses.q_WO),
    ):
        with pytest.raises(ParameterError, match="allowed: two or more, all finite"):
            identify_planar(body, wrong, trajectory(), RADIUS)


FOUND = PlanarProperties(0.4, (0.004, -0.003), 3e-4, 0.12, 0.3)


def test_the_twin_has_what_was_found(tmp_path):
    capture = load_capture(write_pushed_cube(tmp_path / "capture"))
    episode = read_episode(capture, "0000")
    # On another side: z of O is level, x points down, so that y of O is x of Q, and -z is y of Q.
    half = np.sqrt(0.5)
    q_WO = torch.tensor([half, 0.0, half, 0.0], dtype=torch.float64)
    body = make_planar_body(capture.object.mesh_path, q_WO, 0.0, 0.0)
    X_OS = Pose(torch.tensor([1.0, 0.0, 0.0, 0.0]).double(), torch.tensor([1e-3, 0.0, 0.0]).double())
    twin = planar_twin(FOUND, body, capture, [episode], cloud(), (0.25, -0.5), X_OS=X_OS)
    write_twin(tmp_path / "twin", twin)
    read = load_twin(tmp_path / "twin")
    assert {name: one.value for name, one in read.theta.items()} == pytest.approx(
        {"mass": 0.4, "friction_floor": 0.12, "friction_pusher": 0.3}
        | {f"inertia_{axis}": 3e-4 for axis in ("xx", "yy", "zz")}  # a cube's moments are alike
        | {"restitution_floor": 0.0, "restitution_pusher": 0.0}
    )
    assert [name for name, one in read.theta.items() if one.identifiable] == ["friction_floor", "friction_pusher"]
    moved = body.R_QO @ np.array([read.nuisance[f"center_{axis}"].value for axis in "xyz"])
    np.testing.assert_allclose(moved, [0.004, -0.003, 0.0], atol=1e-9)
    assert read.camera_offset == (0.25, -0.5)
    assert identified_push(read, capture, episode) == 0
    assert float(start_pose(read, capture, 0).p[0]) == pytest.approx(1e-3)
    # The physics takes it.
    scene = twin_scene(read, q_WO)
    parameters = twin_parameters(read, scene)
    parameters.check(scene.model)
    np.testing.assert_allclose(parameters.inertia[0, 0], 3e-4 * np.eye(3), atol=1e-12)
