# SPDX-License-Identifier: MIT
import json
import shutil

import numpy as np
import pytest

from pinwm_drake.capture.check import check_capture
from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.importers.pinwm import RATE, import_pinwm, trajectory
from pinwm_drake.capture.importers.target import Scenery
from pinwm_drake.capture.scene import PusherShape, load_capture
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.poses import pose_to_matrix
from tests.capture.cube import HEIGHT, read_static_views
from tests.capture.pushed_cube import FRAMES, RADIUS
from tests.capture.test_nerfstudio import same_views

START, GOAL = np.array([-0.075, 0.0, HEIGHT]), np.array([0.0, 0.0, HEIGHT])


def write_like_theirs(capture_folder, folder, start, goal, *, flat=True):
    """The data of a capture in the layout of PIN-WM's authors: one push, and the static views."""
    capture = load_capture(capture_folder)
    episode = read_episode(capture, "0000")
    images = folder / "dynamic_data_train/train0"
    images.mkdir(parents=True)
    fx, fy, cx, cy = episode.camera.intrinsics.tolist()
    matrix = (pose_to_matrix(episode.X_WC).numpy() @ np.diag([1.0, -1, -1, 1]))[:3].tolist()
    records = []
    for k, name in enumerate(episode.file_names):
        file = f"dynamic_data_train/train0/r_0_{k}.png"
        (folder / file).touch()  # the picture with its background is not read
        shutil.copy(episode.folder / name, images / f"m_0_{k}.png")
        intrinsic = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
        records.append({"time": k / 24, "c2w": matrix, "intrinsic": intrinsic, "file_path": file})
    # Before the push, and from another camera: their loader takes neither.
    records.insert(3, {**records[0], "file_path": "dynamic_data_train/train0/r_0_-1.png"})
    records.insert(0, {**records[2], "file_path": "dynamic_data_train/train0/r_1_0.png"})
    poses = episode.object_poses
    (folder / "dynamic_train0.json").write_text(
        json.dumps(
            {
                "ee_init_position": start.tolist()[: 2 if flat else 3],
                "ee_goal_position": goal.tolist()[: 2 if flat else 3],
                "image_datas": records[::-1],
                "pose_datas": np.hstack([poses.p_WO, poses.q_WO[:, [1, 2, 3, 0]]]).tolist(),
            }
        )
    )
    shutil.copytree(capture_folder / "static", folder, dirs_exist_ok=True)
    (folder / "transforms.json").rename(folder / "transforms_train.json")
    return folder


def follow(folder, moves):
    """Makes the trajectory of a capture the one that their control law gives; the images stay."""
    columns = np.hstack([moves.t[:, None], moves.p_WP, moves.q_WP, moves.v_WP]).tolist()
    head = "t,px,py,pz,qw,qx,qy,qz,vx,vy,vz"
    text = "\n".join([head, *(",".join(map(repr, row)) for row in columns)])
    (folder / "episodes/0000/trajectory.csv").write_text(text)


@pytest.fixture
def theirs(pushed_cube, tmp_path):
    return write_like_theirs(pushed_cube, tmp_path / "theirs", START, GOAL)


@pytest.fixture
def scenery(pushed_cube):
    mesh = pushed_cube / "meshes/object.obj"
    return Scenery("cube", mesh, pusher_shape=PusherShape("sphere", RADIUS), gravity=9.81)


def same_episodes(one, other):
    np.testing.assert_allclose(one.t, other.t, rtol=0, atol=1e-15)
    np.testing.assert_allclose(one.X_WC.p, other.X_WC.p, rtol=0, atol=1e-15)
    np.testing.assert_allclose((one.X_WC.q @ other.X_WC.q).abs(), 1, rtol=0, atol=1e-15)
    assert one.camera.intrinsics.tolist() == other.camera.intrinsics.tolist()
    for name in ("t", "p_WP", "q_WP", "v_WP"):
        np.testing.assert_allclose(getattr(one.trajectory, name), getattr(other.trajectory, name), rtol=0, atol=1e-12)
    for name in ("t", "p_WO", "q_WO"):
        np.testing.assert_allclose(
            getattr(one.object_poses, name), getattr(other.object_poses, name), rtol=0, atol=1e-12
        )
    for a, b in zip(one.file_names, other.file_names, strict=True):
        assert (one.folder / a).read_bytes() == (other.folder / b).read_bytes()


@pytest.mark.parametrize("flat", [True, False])
def test_a_push_comes_back(pushed_cube, scenery, tmp_path, flat):
    follow(pushed_cube, trajectory(START, GOAL, FRAMES))
    theirs = write_like_theirs(pushed_cube, tmp_path / "theirs", START, GOAL, flat=flat)
    out = tmp_path / "out"
    assert import_pinwm(theirs, out, scenery, pusher_height=HEIGHT if flat else None) == ["dynamic_train0.json"]
    given, made = load_capture(pushed_cube), load_capture(out)
    assert made.object.name == "cube"
    assert made.object.X_WO.p.tolist() == given.object.X_WO.p.tolist()
    assert made.pusher.shape == given.pusher.shape
    same_episodes(read_episode(made, "0000"), read_episode(given, "0000"))
    same_views(read_static_views(out), read_static_views(pushed_cube))
    assert check_capture(out).errors == 0


def test_the_released_push_comes_back(shared, tmp_path):
    folder = shared / "data/pinwm_push_t"
    given = load_capture(folder)
    start, v = (getattr(read_episode(given, "0000").trajectory, name)[0] for name in ("p_WP", "v_WP"))
    theirs = write_like_theirs(folder, tmp_path / "theirs", start, start + v / 5)
    assert given.pusher.mesh_path is not None
    scenery = Scenery("t_block", given.object.mesh_path, pusher_mesh=given.pusher.mesh_path)
    import_pinwm(theirs, tmp_path / "out", scenery, pusher_height=float(start[2]))
    made = load_capture(tmp_path / "out")
    same_episodes(read_episode(made, "0000"), read_episode(given, "0000"))
    same_views(read_static_views(tmp_path / "out"), read_static_views(folder))
    assert made.gravity == given.gravity
    assert made.pusher.mesh_path.read_bytes() == given.pusher.mesh_path.read_bytes()


def test_the_pusher_nears_its_goal_by_the_same_share_each_frame():
    moves = trajectory(START, GOAL, 200)
    # p' = p + 5 (goal - p) / 24: what is left shrinks by 1 - 5/24.
    np.testing.assert_allclose(moves.p_WP[:, 0], START[0] * (1 - 5 / RATE) ** np.arange(200), rtol=1e-12)
    assert (moves.p_WP[:, 2] == HEIGHT).all()
    np.testing.assert_allclose(np.diff(moves.p_WP, axis=0), moves.v_WP[:-1] / RATE, atol=1e-15)


def test_several_pushes_are_taken_in_their_order(theirs, scenery, tmp_path):
    for name in ("dynamic_train10", "dynamic_train2", "dynamic_test0"):
        shutil.copy(theirs / "dynamic_train0.json", theirs / f"{name}.json")
    files = import_pinwm(theirs, tmp_path / "out", scenery, pusher_height=HEIGHT)
    assert files == [f"dynamic_{name}.json" for name in ("train0", "train2", "train10", "test0")]
    assert load_capture(tmp_path / "out").episode_names == ["0000", "0001", "0002", "0003"]


def test_frames_may_be_missing_and_cameras_chosen(theirs, scenery, tmp_path):
    path = theirs / "dynamic_train0.json"
    document = json.loads(path.read_text())
    keep = ("0_0.png", "0_3.png", "0_9.png", "1_0.png")
    document["image_datas"] = [data for data in document["image_datas"] if data["file_path"].endswith(keep)]
    path.write_text(json.dumps(document))
    import_pinwm(theirs, tmp_path / "out", scenery, pusher_height=HEIGHT)
    episode = read_episode(load_capture(tmp_path / "out"), "0000")
    np.testing.assert_allclose(episode.t, np.array([0, 3, 9]) / 24)
    assert len(episode.trajectory.t) == 10
    shutil.copy(theirs / "dynamic_data_train/train0/m_0_0.png", theirs / "dynamic_data_train/train0/m_1_0.png")
    import_pinwm(theirs, tmp_path / "other", scenery, pusher_height=HEIGHT, camera=1)
    assert len(read_episode(load_capture(tmp_path / "other"), "0000").t) == 1
    with pytest.raises(InputError, match=r"no image of camera 4; allowed: one of the cameras \[0, 1\]"):
        import_pinwm(theirs, tmp_path / "third", scenery, pusher_height=HEIGHT, camera=4)


def change(key, value, index=None):
    def edit(document):
        if index is None:
            document[key] = value
        else:
            document["image_datas"][index][key] = value

    return edit


@pytest.mark.parametrize(
    ("edit", "parts"),
    [
        (lambda d: d.pop("ee_goal_position"), ["no ee_goal_position"]),
        (lambda d: d.pop("image_datas"), ["no image_datas"]),
        (lambda d: d.pop("pose_datas"), ["no pose_datas", "--pose"]),
        (change("ee_init_position", [1, 2, 3, 4]), ["ee_init_position = [1, 2, 3, 4]"]),
        (change("ee_init_position", [0, float("inf")]), ["ee_init_position[1] = Infinity"]),
        (change("image_datas", []), ["image_datas = []"]),
        (change("pose_datas", [[0] * 7]), ["pose_datas[0]", "norm 1"]),
        (change("pose_datas", [[0] * 6]), ["pose_datas[0]", "7 finite numbers"]),
        (change("file_path", "r_0.png", 5), ["image_datas[5].file_path", "r_CAMERA_FRAME.png"]),
        (change("file_path", "r_0_77.png", 5), ["m_0_77.png", "no such file", "the masked twin of r_0_77.png"]),
        (change("file_path", "dynamic_data_train/train0/r_0_2.png", 5), ["each image once"]),
        (change("c2w", [[1, 0, 0, 0]] * 3, 5), ["c2w", "rigid"]),
        (change("c2w", [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], 5), ["image_datas[5].c2w", "stands still"]),
        (change("intrinsic", [[9, 0, 9], [0, 9, 9], [0, 0, 1]], 5), ["image_datas[5].intrinsic", "one camera"]),
        (change("intrinsic", [[-9, 0, 9], [0, 9, 9], [0, 0, 1]], 5), ["image_datas[5].intrinsic", "positive"]),
    ],
)
def test_wrong_data_are_refused_and_leave_nothing(theirs, scenery, tmp_path, edit, parts):
    path = theirs / "dynamic_train0.json"
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document))
    with pytest.raises(InputError) as caught:
        import_pinwm(theirs, tmp_path / "out", scenery, pusher_height=HEIGHT)
    for part in parts:
        assert part in str(caught.value)
    assert not (tmp_path / "out").exists()
    assert not list(tmp_path.glob(".*"))


def test_heights_and_static_views_have_to_be_known(theirs, scenery, tmp_path):
    with pytest.raises(InputError, match="--pusher-height"):
        import_pinwm(theirs, tmp_path / "out", scenery)
    (theirs / "transforms_train.json").unlink()
    with pytest.raises(InputError, match="--static FILE"):
        import_pinwm(theirs, tmp_path / "out", scenery, pusher_height=HEIGHT)
    with pytest.raises(InputError, match=r"no dynamic_train\*\.json"):
        import_pinwm(tmp_path, tmp_path / "out", scenery, pusher_height=HEIGHT)
    with pytest.raises(InputError, match="no such folder"):
        import_pinwm(tmp_path / "nothing", tmp_path / "out", scenery, pusher_height=HEIGHT)
