import dataclasses

import numpy as np
import pytest

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.policy_scene import check_scene, policy_spec, spec_environment


@pytest.fixture(scope="module")
def env():
    return TaskEnv("push_t", "twin", observation="rgb", frames=2, image_size=32, max_translation=0.02)


@pytest.fixture(scope="module")
def spec(env):
    return policy_spec(env.setup, EnvOptions(frames=2, max_translation=env.run.max_translation), "rgb")


def test_an_environment_of_a_specification_is_the_one_that_it_was_taken_from(env, spec):
    again = spec_environment(spec, "push_t", "point")
    assert again.observation_space == env.observation_space
    assert again.run.max_translation == env.run.max_translation
    assert again.engine == "point"
    assert again.task == env.task
    first, other = env.reset(seed=3)[0], again.reset(seed=3)[0]
    assert np.allclose(first["pusher"], other["pusher"], atol=1e-6)
    assert spec.image_shape == first["image"].shape


def test_the_camera_is_the_scenes(env, spec):
    # A point that the scene looks at lies in the middle of the picture.
    from pydrake.common.eigen_geometry import Quaternion
    from pydrake.math import RigidTransform

    camera = spec.camera
    X_WC = RigidTransform(Quaternion(wxyz=np.array(camera.q_WC)), camera.p_WC)
    x, y, z = X_WC.inverse() @ np.array(env.setup.scenario.camera.p_WT)
    assert z > 0
    assert camera.cx + camera.fx * x / z == pytest.approx(16.0, abs=1e-6)
    assert camera.cy + camera.fy * y / z == pytest.approx(16.0, abs=1e-6)


def test_options_go_before_the_specification(spec):
    env = spec_environment(spec, "push_t", "point", max_steps=7, task={"tolerance": 0.01})
    assert env.max_steps == 7
    assert env.task.tolerance == 0.01


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"horizon": 0.2}, "horizon"),
        ({"pusher_low": (-0.1, -0.1)}, "box"),
        ({"camera": {"fx": 50.0}}, "camera"),
        ({"camera": {"p_WC": (0.0, -0.44, 0.55)}}, "camera"),
        ({"camera": {"q_WC": (1.0, 0.0, 0.0, 0.0)}}, "camera"),
        ({"camera": {"width": 64}}, "camera"),
    ],
)
def test_another_scene_is_refused(env, spec, change, message):
    if isinstance(change.get("camera"), dict):
        change = {"camera": dataclasses.replace(spec.camera, **change["camera"])}
    with pytest.raises(ParameterError, match=message):
        check_scene(dataclasses.replace(spec, **change), env.setup)
