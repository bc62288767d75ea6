# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.capture.write import write_episode_tables
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.identification.poses.tracker import PoseTracker, PoseTrackerOptions
from pinwm_drake.report.twin.score import pose_errors
from pinwm_drake.spatial.poses import Pose, compose, inverse
from tests.identification.samples import FRAMES, SIZE, camera, surfels, trajectory, write_capture
from tests.rendering.boxes import look_at
from tests.report.samples import picture

OPTIONS = PoseTrackerOptions(num_threads=1)
# One pixel of these pictures at the object, m: the camera is 0.3 m away, with a focal length of 144 px.
PIXEL = 0.3 / (1.5 * SIZE)


@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    """A capture whose cube is pushed by 5 cm and turned, its episode, and the track.

    The tracker is told poses that are wrong: it does not look at them.
    """
    capture = load_capture(write_capture(tmp_path_factory.mktemp("tracker") / "capture"))
    episode = read_episode(capture, "0000")
    poses = episode.object_poses
    wrong = replace(poses, p_WO=poses.p_WO[::-1] + np.array([0.05, 0.0, 0.02]))
    return capture, episode, tracker(capture).track(replace(episode, object_poses=wrong))


def tracker(capture):
    return PoseTracker(capture, surfels(), (0.0, 0.0), OPTIONS)


def heights(track, truth):
    return np.abs(track.poses.p_WO[:, 2] - truth.p_WO[:, 2])


def test_the_object_is_followed(pushed):
    _, episode, track = pushed
    truth = episode.object_poses
    moved = np.linalg.norm(truth.p_WO[-1] - truth.p_WO[0])
    assert moved > 10.0 * PIXEL  # far more than what a tracker that stays would get away with
    errors = pose_errors(track.poses, truth)
    assert len(errors.t) == FRAMES
    # The outline, which is cut at half a pixel's opacity, leaves a pixel, along the line of sight a few.
    assert errors.position.max() < PIXEL
    assert heights(track, truth).max() < PIXEL
    assert np.degrees(errors.rotation.max()) < 2.0
    assert np.isfinite(track.loss).all()


def test_an_object_that_is_not_seen_stays_where_it_was(pushed, tmp_path):
    episode = read_episode(load_capture(write_capture(tmp_path / "capture")), "0000")
    capture, _, track = pushed
    for k in (4, 5):
        Image.new("RGBA", (SIZE, SIZE)).save(episode.folder / episode.file_names[k])
    found = tracker(capture).track(episode)
    assert np.flatnonzero(np.isnan(found.loss)).tolist() == [4, 5]
    assert np.array_equal(found.poses.p_WO[5], found.poses.p_WO[3])
    # It is found again, a few centimetres farther on.
    assert np.linalg.norm(found.poses.p_WO[6:] - track.poses.p_WO[6:], axis=1).max() < PIXEL


def test_cameras_are_looked_at_together(pushed, tmp_path):
    """A second camera from another side tells what is far and near for the first one."""
    capture = load_capture(write_capture(tmp_path / "capture"))
    truth = read_episode(capture, "0000").object_poses
    folder, (lens, _) = capture.folder / "episodes/0000/cameras/side", camera()
    X_WC = inverse(look_at((0.3, 0.15, 0.1), (0.05, 0.0, 0.02)))
    names = [f"{k}.png" for k in range(FRAMES)]
    write_episode_tables(folder, lens, X_WC, names, truth.t, trajectory(), None)
    for k, name in enumerate(names):
        X_WO = Pose(torch.from_numpy(truth.q_WO[k]), torch.from_numpy(truth.p_WO[k]))
        picture(surfels(), lens, compose(inverse(X_WC), X_WO)).save(folder / name)
    found = tracker(capture).track(read_episode(capture, "0000"))
    assert np.array_equal(found.poses.t, truth.t)
    assert pose_errors(found.poses, truth).position.mean() < 0.8 * pose_errors(pushed[2].poses, truth).position.mean()


def test_an_object_that_is_elsewhere_is_refused(pushed):
    capture, episode, _ = pushed
    X_WO = capture.object.X_WO
    away = replace(capture.object, X_WO=Pose(X_WO.q, X_WO.p + torch.tensor([0.03, 0.0, 0.0], dtype=torch.float64)))
    with pytest.raises(InputError, match="away from where it should be"):
        tracker(replace(capture, object=away)).track(episode)


@pytest.mark.parametrize("change", [{"size": 8.0}, {"steps": 0}, {"num_threads": 0}])
def test_settings_out_of_range_are_refused(change):
    with pytest.raises(ParameterError, match=next(iter(change))):
        PoseTrackerOptions(**change)
