# SPDX-License-Identifier: MIT
import json

import numpy as np
import pytest
import torch
from PIL import Image

from pinwm_drake.capture.episodes import pose_at, read_episode, read_episode_folder
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import InputError
from tests.capture.pushed_cube import FRAMES, SIZE, poses, read_frames, times, trajectory


def lines_of(folder, name):
    return (folder / "episodes/0000" / name).read_text().splitlines()


def rewrite(folder, name, lines):
    (folder / "episodes/0000" / name).write_text("\n".join(lines))


def cell(folder, name, row, column, text):
    """Changes a cell of the table; rows are lines of the file."""
    lines = lines_of(folder, name)
    cells = lines[row - 1].split(",")
    cells[lines[0].split(",").index(column)] = text
    lines[row - 1] = ",".join(cells)
    rewrite(folder, name, lines)


def read(folder):
    return read_episode(load_capture(folder), "0000")


def test_an_episode_is_read(pushed_cube):
    capture, episode = read_episode_folder(pushed_cube / "episodes/0000")
    assert capture.folder == pushed_cube
    assert (episode.name, episode.folder) == ("0000", pushed_cube / "episodes/0000")
    assert episode.file_names == [f"rgb/{k:05}.png" for k in range(FRAMES)]
    np.testing.assert_array_equal(episode.t, times())
    expected = trajectory()
    for name in ("t", "p_WP", "q_WP", "v_WP"):
        np.testing.assert_array_equal(getattr(episode.trajectory, name), getattr(expected, name))
    assert episode.trajectory.force_W is None
    np.testing.assert_array_equal(episode.object_poses.p_WO, poses().p_WO)
    assert (episode.camera.width, episode.camera.height) == (SIZE, SIZE)


def test_a_folder_is_found_from_within(pushed_cube, monkeypatch):
    monkeypatch.chdir(pushed_cube / "episodes")
    assert read_episode_folder(type(pushed_cube)("0000"))[1].name == "0000"


def test_frames_are_colours_on_white(pushed_cube):
    episode = read(pushed_cube)
    images, masks = read_frames(episode)
    assert images.shape == (FRAMES, SIZE, SIZE, 3)
    assert masks.shape == (FRAMES, SIZE, SIZE)
    assert (images.dtype, masks.dtype) == (torch.float32, torch.bool)
    assert (images[~masks] == 1).all()
    for k in range(FRAMES):
        alpha = np.asarray(Image.open(episode.folder / episode.file_names[k]))[..., 3]
        np.testing.assert_array_equal(masks[k], alpha >= 128)


def test_a_frame_may_show_nothing_and_masks_may_stand_beside(pushed_cube):
    episode = pushed_cube / "episodes/0000"
    Image.new("RGBA", (SIZE, SIZE)).save(episode / "rgb/00003.png")
    images, masks = read_frames(read(pushed_cube))
    assert not masks[3].any()
    assert (images[3] == 1).all()
    (episode / "masks").mkdir()
    for k in range(FRAMES):
        mask = np.zeros((SIZE, SIZE), np.uint8)
        mask[20 : 30 + k, 20:30] = 255
        Image.fromarray(mask).save(episode / f"masks/{k:05}.png")
    _, masks = read_frames(read(pushed_cube))
    assert masks.sum((1, 2)).tolist() == [10 * (10 + k) for k in range(FRAMES)]


def test_poses_and_forces_are_optional(pushed_cube):
    (pushed_cube / "episodes/0000/object_poses.csv").unlink()
    lines = lines_of(pushed_cube, "trajectory.csv")
    forces = [f"{line},{k},0,-1.5" for k, line in enumerate(lines)]
    rewrite(pushed_cube, "trajectory.csv", [lines[0] + ",fx,fy,fz", *forces[1:]])
    episode = read(pushed_cube)
    assert episode.object_poses is None
    expected = np.stack([np.arange(1.0, FRAMES + 1), np.zeros(FRAMES), np.full(FRAMES, -1.5)], axis=-1)
    np.testing.assert_array_equal(episode.trajectory.force_W, expected)


def test_quaternions_are_normalised_to_rounding(pushed_cube):
    cell(pushed_cube, "trajectory.csv", 4, "qw", "1.000004")
    q = read(pushed_cube).trajectory.q_WP
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1, atol=1e-15)


@pytest.mark.parametrize(
    ("name", "row", "column", "text", "parts"),
    [
        ("frames.csv", 4, "t", "0.01", ["row 4", "t = 0.01", "a time after 0.0416666667 s"]),
        ("frames.csv", 11, "t", "0.4", ["row 11", "t = 0.4", "within trajectory.csv: 0 s to 0.375 s"]),
        ("frames.csv", 2, "t", "-0.1", ["row 2", "t = -0.1", "within trajectory.csv"]),
        ("frames.csv", 3, "frame", "0", ["row 3", "frame = 0", "larger than"]),
        ("frames.csv", 3, "frame", "1.5", ["row 3", "frame = 1.5", "whole number"]),
        ("frames.csv", 5, "file_path", "rgb/none.png", ["rgb/none.png", "no such file", "frames.csv, row 5"]),
        ("frames.csv", 5, "file_path", "rgb", ["rgb", "a folder"]),
        ("frames.csv", 5, "file_path", "", ["row 5", "file_path = ''"]),
        ("frames.csv", 5, "file_path", "rgb/00000.png", ["row 5", "each image once (it is in row 2 too)"]),
        ("trajectory.csv", 6, "px", "nan", ["row 6", "px = nan"]),
        ("trajectory.csv", 6, "px", "70000", ["row 6", "px = 70000", "-1000 to 1000"]),
        ("trajectory.csv", 7, "qz", "0.5", ["row 7", "norm 1.11803"]),
        ("trajectory.csv", 1, "vx", "ux", ["row 1", "vx,vy,vz"]),
        ("trajectory.csv", 3, "t", "0", ["row 3", "again"]),
        ("object_poses.csv", 3, "pz", "inf", ["row 3", "pz = inf"]),
    ],
)
def test_wrong_cells_are_refused_with_file_row_and_value(pushed_cube, name, row, column, text, parts):
    cell(pushed_cube, name, row, column, text)
    with pytest.raises(InputError) as caught:
        read(pushed_cube)
    for part in (name if "png" not in text else "", *parts):
        assert part in str(caught.value)


def test_wrong_cameras_are_refused(pushed_cube):
    path = pushed_cube / "episodes/0000/camera.json"
    whole = json.loads(path.read_text())
    for change, part in (
        ({"fl_x": -1}, "fl_x = -1"),
        ({"camera_model": "OPENCV_FISHEYE"}, "OPENCV_FISHEYE"),
        ({"transform_matrix": 3}, "transform_matrix = 3"),
        ({"transform_matrix": [[1, 0, 0, 1e5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, "within 1000 m"),
    ):
        path.write_text(json.dumps({**whole, **change}))
        with pytest.raises(InputError, match=r"camera\.json") as caught:
            read(pushed_cube)
        assert part in str(caught.value)


def test_sizes_have_to_agree(pushed_cube):
    Image.new("RGBA", (40, SIZE)).save(pushed_cube / "episodes/0000/rgb/00002.png")
    episode = read(pushed_cube)
    with pytest.raises(InputError, match=r"rgb/00002.png: got 40 x 64 px; allowed: 64 x 64 px, as .*camera.json"):
        read_frames(episode)


def test_unknown_episodes_are_refused(pushed_cube):
    capture = load_capture(pushed_cube)
    for name in ("0001", "../episodes/0000", ""):
        with pytest.raises(InputError, match=r"no episode .* allowed: 0000"):
            read_episode(capture, name)
    with pytest.raises(InputError, match="outside of episodes"):
        read_episode_folder(pushed_cube)


def test_the_released_episode_is_read(shared):
    episode = read_episode(load_capture(shared / "data/pinwm_push_t"), "0000")
    assert len(episode.t) == len(episode.trajectory.t) == 32
    # The pusher moves on straight lines: commanded velocity held for one period.
    moved = np.diff(episode.trajectory.p_WP, axis=0)
    np.testing.assert_allclose(moved, episode.trajectory.v_WP[:-1] * np.diff(episode.trajectory.t)[:, None], atol=1e-12)


def test_the_pusher_between_two_rows_of_its_log(pushed_cube):
    episode = read(pushed_cube)
    log = episode.trajectory
    half = episode.pusher_pose(0.5 * (log.t[2] + log.t[3]))
    np.testing.assert_allclose(half.p, 0.5 * (log.p_WP[2] + log.p_WP[3]), rtol=0, atol=1e-15)
    for time, row in ((log.t[0] - 1.0, 0), (log.t[4], 4), (log.t[-1] + 1.0, -1)):
        np.testing.assert_array_equal(episode.pusher_pose(time).p, log.p_WP[row])
        np.testing.assert_array_equal(episode.pusher_pose(time).q, log.q_WP[row])


def test_a_pose_turns_the_shorter_way():
    angle = 0.3
    there = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    for sign in (1.0, -1.0):
        q = np.stack([[1.0, 0.0, 0.0, 0.0], sign * there])
        found = pose_at(np.array([0.0, 2.0]), np.zeros((2, 3)), q, 1.0)
        np.testing.assert_allclose(found.q, [np.cos(angle / 4), 0.0, 0.0, np.sin(angle / 4)], rtol=0, atol=1e-15)
