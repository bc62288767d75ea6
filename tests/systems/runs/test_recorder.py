# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import trimesh
from pydrake.math import RigidTransform

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import object_model
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.systems.pusher.choice import choose_push
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.runs.recorder import Rates, SceneRecorder
from pinwm_drake.systems.scenario.schema import Physics, Plant, Pusher, Scenario, Theta
from pinwm_drake.systems.sdf.collision import divided
from tests.systems.scenes import SPHERE

SHAPES = [SPHERE, PusherShape("cylinder", 0.01, 0.06), PusherShape("capsule", 0.01, 0.06)]


def standing(name):
    mesh = load_mesh(object_model(name).mesh_path)
    mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
    return mesh


def gap(points_P, shape):
    """Distance between the pusher and the nearest of some points (n, 3), its frame; m, negative inside."""
    beyond = np.maximum(np.abs(points_P[:, 2]) - 0.5 * shape.length, 0)
    radial = np.linalg.norm(points_P[:, :2], axis=1)
    if shape.kind == "cylinder":
        return np.where(beyond > 0, np.hypot(beyond, np.maximum(radial - shape.radius, 0)), radial - shape.radius).min()
    return (np.hypot(radial, beyond) - shape.radius).min()


def test_divided_triangles_are_the_same_surface():
    mesh = standing("mug")
    triangles = divided(mesh.triangles, 0.02)
    assert np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2).max() <= 0.02
    again = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=False)
    assert again.area == pytest.approx(mesh.area)
    assert again.volume == pytest.approx(mesh.volume)


RATES = Rates(24.0, 10, 8)


def scenario(period):
    step = RATES.time_step
    return Scenario(
        object="cube",
        engine="hydroelastic",
        theta=Theta(friction_floor=0.1, friction_pusher=0.1),
        pusher=Pusher(period=period),
        physics=Physics(time_step=period),
        plant=Plant(time_step=step),
    )


@pytest.fixture(scope="module", params=[pytest.param(1, marks=pytest.mark.nightly), 8])
def recorder(request):
    """The pusher's velocity changes at every step of the plant, or with the rows of the log."""
    return SceneRecorder(scenario(request.param * RATES.time_step), RATES, Camera.from_field_of_view(32, 32, 0.7), 1)


def test_a_recording_is_the_pushers_log_and_the_objects_poses(recorder):
    X_WO = recorder.settle(RigidTransform([0.01, 0, 0.03]))
    push = choose_push(
        standing("cube"), X_WO.translation(), SPHERE, np.random.default_rng(0), height=0.03, speed=0.1, distance=0.02
    )
    number = 9
    recording = recorder.push(X_WO, push, number)
    log, poses = recording.trajectory, recording.object_poses
    np.testing.assert_allclose(recording.t, np.arange(number) / 24)
    np.testing.assert_allclose(log.t, np.arange((number - 1) * 10 + 1) / 240)
    assert log.t[-1] == recording.t[-1]
    np.testing.assert_array_equal(poses.t, recording.t)
    np.testing.assert_array_equal(log.p_WP[0], push.p_WP)
    # It stays at rest until the pusher is there, and moves forwards then.
    assert np.linalg.norm(poses.p_WO[1] - X_WO.translation()) < 1e-8
    assert (poses.p_WO[-1] - poses.p_WO[0]) @ push.direction_W > 0.01
    np.testing.assert_allclose(np.linalg.norm(poses.q_WO, axis=1), 1, atol=1e-12)
    # The pusher is where its commanded velocity takes it: an impact of 0.1 m/s costs its drive some micrometres.
    moved = log.p_WP[0] + np.concatenate([np.zeros((1, 3)), np.cumsum(log.v_WP[:-1] / 240, axis=0)])
    np.testing.assert_allclose(log.p_WP, moved, atol=1e-5)
    seen = []
    again = recorder.push(X_WO, push, number, lambda t, X: seen.append((t, X)))
    np.testing.assert_array_equal(again.object_poses.p_WO, poses.p_WO)
    np.testing.assert_array_equal(again.trajectory.p_WP, log.p_WP)
    # The one who watches sees the log's times and poses, and may end the push.
    np.testing.assert_array_equal([t for t, _ in seen], log.t)
    assert [X for _, X in seen] == again.logged

    def enough(t, X_WO):
        if t > 0.1:
            raise LookupError(f"{t:.3f}")

    with pytest.raises(LookupError, match=r"0\.104"):
        recorder.push(X_WO, push, number, enough)
    np.testing.assert_array_equal(recorder.push(X_WO, push, number).object_poses.p_WO, poses.p_WO)


def test_the_log_has_the_force_on_the_pusher(recorder):
    feeling = SceneRecorder(
        scenario(recorder.station.setup.period), RATES, Camera.from_field_of_view(32, 32, 0.7), 1, forces=True
    )
    X_WO = recorder.settle(RigidTransform([0.0, 0, 0.03]))
    # Along x through the middle of a face, which is 5 mm away.
    push = StraightPush(np.array([-0.045, 0.0, 0.03]), np.array([1.0, 0.0, 0.0]), 0.1, 0.05, 10.0)
    plain, felt = (one.push(X_WO, push, 9) for one in (recorder, feeling))
    assert plain.trajectory.force_W is None
    np.testing.assert_array_equal(felt.trajectory.p_WP, plain.trajectory.p_WP)
    np.testing.assert_array_equal(felt.object_poses.p_WO, plain.object_poses.p_WO)
    t, force_W = felt.trajectory.t, felt.trajectory.force_W
    assert force_W.shape == (len(t), 3)
    assert not force_W[t < 0.04].any()
    # The pusher goes along x, and the cube of 1 kg pushes back with the floor's friction of 0.1.
    np.testing.assert_allclose(force_W[(t > 0.2) & (t < 0.3)].mean(axis=0), [-0.981, 0, 0], atol=0.02)
    # All of the impulse: the impact, of which a row sees little, gives the speed of the push.
    given = -force_W[t < 0.3, 0].sum() / 240
    assert given == pytest.approx(1.0 * 0.1 + 0.981 * (0.3 - 0.055), rel=0.05)


def test_a_log_whose_rows_are_no_whole_number_of_periods_is_refused():
    with pytest.raises(
        ParameterError, match=r"a row of the pusher's log: got 0\.00416667 s; .* pusher\.period, 0\.003"
    ):
        SceneRecorder(scenario(6 * RATES.time_step), RATES, Camera.from_field_of_view(32, 32, 0.7), 1)
