# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.rigid import from_pose, rigid
from pinwm_drake.station.document import StationDocument, write_station
from pinwm_drake.station.episode import Sources, add_episode
from pinwm_drake.station.eye import eye_of
from tests.station.drawn_push import draw_push, place, write_csv_log, write_drawn_capture, write_mp4
from tests.station.stations import plain_station, pose

X_BW = rigid(w=[0.03, -0.02, 0.0])


@pytest.fixture
def station(tmp_path):
    """The camera of a drawn push as a station, whose robot is tilted against W."""
    push, document = draw_push(), plain_station()
    fx, fy, cx, cy = push.camera.intrinsics.tolist()
    document["camera"] |= {
        "size": [push.camera.width, push.camera.height],
        "K": [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
        "distortion": [0.0] * 5,
        "X_WC": pose(from_pose(push.X_WC)),
    }
    document["world"]["X_BW"] = pose(X_BW)
    return push, write_station(tmp_path / "station.yaml", StationDocument.model_validate(document))


def test_film_and_log_of_a_station_become_an_episode_in_w(station, tmp_path):
    push, made = station
    capture = write_drawn_capture(tmp_path / "capture", push)
    push.p_WP[:] = push.p_WP @ X_BW[:3, :3].T  # as the robot logs it, in its base
    log = write_csv_log(tmp_path / "robot.csv", push)
    video = write_mp4(tmp_path / "push.mp4", push.frames)
    added = add_episode(capture, Sources(video, log, camera=made.path, offset=push.offset, exact=True))
    episode = read_episode(load_capture(capture), "0000")
    found = [episode.pusher_pose(time).p.numpy() for time in episode.t.tolist()]
    np.testing.assert_allclose(found, place(push.t), atol=5e-4)  # noise of the log: 0.1 mm
    np.testing.assert_allclose(episode.camera.intrinsics, push.camera.intrinsics)
    assert any("from the robot's base into W" in note for note in added.clock.notes)


def test_a_film_of_another_size_is_refused(station):
    _, made = station
    with pytest.raises(InputError, match="allowed: 320 x 240 px, why"):
        eye_of(made).require_size(made.path, np.zeros((10, 20, 3)), "why")


def test_a_pinhole_shows_what_the_lens_shows(station):
    push, made = station
    assert np.abs(eye_of(made).seen(push.frames[0]).astype(int) - push.frames[0]).mean() < 0.5
