# SPDX-License-Identifier: MIT
import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import InputError, ParameterError, PinwmError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import model_path, twin_path
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.policy_scene import (
    check_object,
    check_scene,
    home_scene,
    policy_setup,
    policy_spec,
    scene_record,
    scene_spec,
    spec_environment,
)
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.schema import Shape
from pinwm_drake.systems.scenario.setup import make_setup
from pinwm_drake.twin.read import load_twin


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


def test_the_scene_is_told_in_numbers(env, spec):
    scene = spec.scene
    assert (scene.object.name, scene.object.size, scene.floor_height) == ("t_block", (0.1, 0.14, 0.05), 0.0)
    mesh = load_mesh(model_path("t_block/t_block.obj"))
    np.testing.assert_allclose(scene.object.middle, mesh.bounds.mean(axis=0), atol=1e-9)
    assert abs(scene.object.middle[1]) > 0.01  # O is at the centre of mass, and not in the middle of the box
    assert (scene.pusher.shape, scene.pusher.radius, scene.pusher.length) == ("sphere", 0.01, 0.0)
    check_object(spec, env.setup)
    check_object(dataclasses.replace(spec, scene=None), load_setup("push_mug"))


def test_a_pusher_of_a_mesh_is_told_by_its_hash(env, tmp_path):
    path = tmp_path / "pusher.obj"
    shutil.copy(model_path("cube/cube.obj"), path)
    setup = with_pusher(env.setup, PusherGeometry(path, None))
    about = scene_spec(setup).pusher
    assert about.shape == "mesh"
    assert (about.radius, about.length) == pytest.approx((0.03 * 2**0.5, 0.06))
    assert about.mesh_sha256 == scene_spec(load_setup("push_cube")).object.mesh_sha256


def with_pusher(setup, pusher):
    return dataclasses.replace(setup, twin=dataclasses.replace(setup.twin, pusher=pusher))


def test_another_object_pusher_or_floor_is_refused(env, spec, tmp_path):
    def refused(setup) -> str:
        with pytest.raises(ParameterError) as error:
            check_object(spec, setup)
        message, force = str(error.value).rsplit(", the policy's; ", 1)
        assert force == "--force controls it all the same"
        return message

    block = "allowed: t_block, 100 x 140 x 50 mm"
    assert refused(load_setup("push_cube")) == f"object: got cube, 60 x 60 x 60 mm; {block}"
    assert refused(load_setup("push_large_t")) == f"object: got large_t, 140 x 196 x 70 mm; {block}"
    copy = tmp_path / "object.obj"
    copy.write_text(env.setup.twin.mesh_path.read_text() + "# changed\n")
    message = refused(dataclasses.replace(env.setup, twin=dataclasses.replace(env.setup.twin, mesh_path=copy)))
    assert f"{block}, mesh {spec.scene.object.mesh_sha256[:8]}" in message
    scenario = env.setup.scenario
    longer = dataclasses.replace(scenario.pusher, shape=Shape("capsule", 0.012, 0.05))
    assert (
        refused(make_setup(dataclasses.replace(scenario, pusher=longer)))
        == "pusher: got a capsule of 12 mm, 50 mm long; allowed: a sphere of 10 mm"
    )
    thicker = PusherGeometry(None, PusherShape("sphere", 0.011))
    assert refused(with_pusher(env.setup, thicker)) == "pusher: got a sphere of 11 mm; allowed: a sphere of 10 mm"
    for height, good in ((0.0019, True), (-0.0021, False)):
        setup = dataclasses.replace(env.setup, twin=dataclasses.replace(env.setup.twin, floor_height=height))
        if good:
            check_object(spec, setup)
        else:
            assert refused(setup) == "floor: got -2.1 mm; allowed: 0.0 mm, give or take 2 mm"


def test_the_floor_of_a_policy_that_does_not_tell_it_is_as_far_below_its_camera(env, spec):
    x, y, z = spec.camera.p_WC
    higher = dataclasses.replace(spec.camera, p_WC=(x, y, z + 0.0015))
    assert scene_spec(env.setup, higher).floor_height == pytest.approx(0.0015, abs=1e-12)


@pytest.mark.parametrize("scene", ["push_t", "push_cube", "push_cube_slippery", "flip_cube", "flip_mug"])
def test_the_own_scene_of_a_policy_is_that_of_its_training(scene):
    spec = policy_spec(load_setup(scene), EnvOptions(), "state")
    assert home_scene(spec, {"home": scene_record(scene, None)}, "anywhere").scenario.name == scene
    assert home_scene(spec, {"policy": {"home": scene_record(scene, None)}}, "a bundle").scenario.name == scene
    # As older policies have it: the scene's name.
    assert home_scene(spec, {"trained_in": {"scene": scene}}, "anywhere").scenario.name == scene


def test_a_policy_of_an_older_version_has_the_scene_that_ships_for_its_object(spec):
    assert home_scene(spec, {}, "policy").scenario.name == "push_t"
    kettle = dataclasses.replace(spec.scene.object, name="kettle", mesh_sha256="0" * 64)
    strange = dataclasses.replace(spec, scene=dataclasses.replace(spec.scene, object=kettle))
    wanted = "--scene with the twin or scenario of kettle, 100 x 140 x 50 mm"
    with pytest.raises(InputError, match=f"policy: got a policy that does not tell its scene; allowed: {wanted}"):
        home_scene(strange, {}, "policy")
    with pytest.raises(InputError, match="--scene with the twin or scenario of its object"):
        home_scene(dataclasses.replace(spec, scene=None), {}, "policy")


def test_a_twin_is_found_where_it_was_or_beside_the_policy(tmp_path):
    shutil.copytree(twin_path("t_block"), tmp_path / "here/out/mine")
    record = scene_record(str(tmp_path / "here/out/mine"), None)
    spec = policy_spec(load_setup(tmp_path / "here/out/mine"), EnvOptions(), "state")
    found = home_scene(spec, {"home": record}, tmp_path / "here/out/policy")
    assert Path(found.scenario.twin) == tmp_path / "here/out/mine"
    assert found.twin.floor_height == load_twin(twin_path("t_block")).floor_height
    (tmp_path / "here").rename(tmp_path / "there")
    found = home_scene(spec, {"home": record}, tmp_path / "there/out/policy")
    assert Path(found.scenario.twin) == tmp_path / "there/out/mine"
    with pytest.raises(InputError, match=f"no scene of its training at {tmp_path}/here/out/mine; allowed: --scene"):
        home_scene(spec, {"home": record}, tmp_path / "elsewhere/policy")
    # Placed in another scenario, it is there again.
    placed = scene_record(str(tmp_path / "there/out/mine"), "push_cube")
    cube = policy_spec(load_setup("push_cube", twin=tmp_path / "there/out/mine"), EnvOptions(), "state")
    assert home_scene(cube, {"home": placed}, tmp_path).scenario.name == "push_cube"
    # A twin in the same place whose mesh is another one is refused.
    mesh = tmp_path / "there/out/mine/meshes/object.obj"
    mesh.write_text(model_path("cube/cube.obj").read_text())
    with pytest.raises(PinwmError, match="object"):
        home_scene(spec, {"home": record}, tmp_path / "there/out/policy")


def test_a_scene_of_another_object_is_refused_unless_it_is_asked_for(spec):
    with pytest.raises(ParameterError, match=r"object: got cube, 60 x 60 x 60 mm; allowed: t_block.*; ask for it"):
        policy_setup(spec, {}, "policy", "push_cube", "ask for it")
    assert policy_setup(spec, {}, "policy", "push_cube", None).twin.name == "cube"
    assert policy_setup(spec, {}, "policy", None).twin.name == "t_block"
