# SPDX-License-Identifier: MIT
import json

import numpy as np
import pytest
import torch

from pinwm_drake.capture.episodes import PusherTrajectory, read_episode
from pinwm_drake.capture.scene import PusherShape, load_capture
from pinwm_drake.capture.transforms import read_transforms
from pinwm_drake.capture.write import write_capture_yaml, write_episode_tables, write_posed_images
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import normalize_quaternion, quaternion_to_matrix


def random_pose(rng):
    return Pose(normalize_quaternion(torch.tensor(rng.normal(size=4))), torch.tensor(rng.normal(size=3)))


def camera(rng, width=64, height=48):
    return Camera(width, height, torch.tensor(rng.uniform(20, 80, 4)))


def close(one, other):
    """Whether two poses are the same; a quaternion and its opposite are."""
    torch.testing.assert_close(quaternion_to_matrix(one.q), quaternion_to_matrix(other.q), rtol=0, atol=1e-14)
    torch.testing.assert_close(one.p, other.p, rtol=0, atol=1e-15)


def test_a_scene_comes_back_as_it_was_written(tmp_path):
    rng = np.random.default_rng(0)
    X_WO = random_pose(rng)
    (tmp_path / "a.obj").write_text("v")
    (tmp_path / "episodes/0000").mkdir(parents=True)
    for shape, mesh, mass in ((PusherShape("capsule", 0.01, 0.1), None, 0.123456789012345), (None, "a.obj", None)):
        write_capture_yaml(
            tmp_path,
            name="Tasse – é",
            mesh="a.obj",
            mass=mass,
            X_WO=X_WO,
            pusher_mesh=mesh,
            pusher_shape=shape,
            floor_height=np.float64(-1e-3),
            gravity=9.81,
        )
        capture = load_capture(tmp_path)
        assert (capture.object.name, capture.object.mass) == ("Tasse – é", mass)
        close(capture.object.X_WO, X_WO)
        assert capture.pusher.shape == shape
        assert capture.pusher.mesh_path == (None if mesh is None else tmp_path / mesh)
        assert (capture.floor_height, capture.gravity) == (-1e-3, 9.81)


def test_views_come_back_as_they_were_written(tmp_path):
    rng = np.random.default_rng(1)
    poses = [random_pose(rng) for _ in range(3)]
    path = tmp_path / "static/transforms.json"
    own = camera(np.random.default_rng(2))
    write_posed_images(path, [(f"{k}.png", own, X) for k, X in enumerate(poses)])
    for k, frame in enumerate(read_transforms(path)):
        assert frame.file_path == f"{k}.png"
        assert frame.camera.intrinsics.tolist() == camera(np.random.default_rng(2)).intrinsics.tolist()
        close(frame.X_WC, poses[k])
    # nerfstudio's axes: y up, z backward.
    matrix = np.array(json.loads(path.read_text())["frames"][0]["transform_matrix"])
    np.testing.assert_allclose(matrix[:3, 2], -quaternion_to_matrix(poses[0].q)[:, 2], atol=1e-15)


def test_cameras_may_differ(tmp_path):
    rng = np.random.default_rng(3)
    cameras, X_WC = [camera(rng), camera(rng, 32, 20), camera(rng)], random_pose(rng)
    write_posed_images(tmp_path / "t.json", [(f"{k}.png", cameras[k], X_WC) for k in range(3)])
    for frame, own in zip(read_transforms(tmp_path / "t.json"), cameras, strict=True):
        assert (frame.camera.width, frame.camera.height) == (own.width, own.height)
        assert frame.camera.intrinsics.tolist() == own.intrinsics.tolist()


@pytest.mark.parametrize("force", [False, True])
def test_an_episode_comes_back_as_it_was_written(pushed_cube, force):
    rng, capture = np.random.default_rng(4), load_capture(pushed_cube)
    given = read_episode(capture, "0000")
    m = 40
    q = rng.normal(size=(m, 4))
    trajectory = PusherTrajectory(
        t=np.cumsum(rng.uniform(0.01, 0.02, m)) - 0.02,
        p_WP=rng.normal(size=(m, 3)),
        q_WP=q / np.linalg.norm(q, axis=-1, keepdims=True),
        v_WP=rng.normal(size=(m, 3)),
        force_W=rng.normal(size=(m, 3)) if force else None,
    )
    write_episode_tables(given.folder, given.camera, given.X_WC, given.file_names, given.t, trajectory, None)
    episode = read_episode(capture, "0000")
    for name in ("t", "p_WP", "v_WP", *(["force_W"] if force else [])):
        np.testing.assert_array_equal(getattr(episode.trajectory, name), getattr(trajectory, name))
    np.testing.assert_allclose(episode.trajectory.q_WP, trajectory.q_WP, rtol=0, atol=3e-16)
    np.testing.assert_array_equal(episode.t, given.t)
    assert episode.file_names == given.file_names
    # Poses that are not known are not left over from before.
    assert episode.object_poses is None
    assert not list(given.folder.glob(".*"))


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError):
        write_posed_images(tmp_path / "file/t.json", [])
