# SPDX-License-Identifier: MIT
import dataclasses

import cv2
import numpy as np
import pytest

from pinwm_drake.capture.clock import read_clock
from pinwm_drake.capture.episodes import read_episode, read_episode_image, read_fixed_camera
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.station.episode import Sources, add_episode
from tests.station.drawn_push import draw_push, place, write_csv_log, write_drawn_capture, write_mp4

EPOCH = 1.7e9
# The bar of the issue.
BAR = 5e-3


@pytest.fixture(scope="module")
def push():
    return draw_push()


@pytest.fixture
def made(push, tmp_path):
    """A capture, and the sources of an episode."""
    capture = write_drawn_capture(tmp_path / "capture", push)
    video = write_mp4(tmp_path / "push.mp4", push.frames)
    log = write_csv_log(tmp_path / "robot.csv", push, epoch=EPOCH)
    return capture, Sources(video, log, camera=capture / "camera.json")


def test_an_episode_is_added_on_the_log_s_clock(push, made):
    capture, sources = made
    added = add_episode(capture, sources)
    episode = read_episode(load_capture(capture), "0000")
    assert added.folder.name == "0000"
    assert added.images == len(push.t) == len(episode.t)
    assert not added.masked
    clock = read_clock(added.folder)
    assert clock == episode.clock == added.clock
    assert clock.offset - EPOCH == pytest.approx(push.offset, abs=BAR)
    low, high = clock.interval
    # Twice the interval: four standard deviations, which a right one misses with a chance of 6e-5.
    assert abs(push.offset + EPOCH - 0.5 * (low + high)) < high - low < 2 * BAR
    assert any("t taken for ms" in note for note in clock.notes)
    # At each image the log has the pusher where it was.
    found = [episode.pusher_pose(time).p.numpy() for time in episode.t.tolist()]
    np.testing.assert_allclose(found, place(push.t), atol=BAR * 0.4 + 5e-4)  # at 0.4 m/s at most, and the log's noise
    assert episode.trajectory.t[0] == 0.0
    assert episode.t[0] - episode.trajectory.t[0] >= 0.5
    with pytest.raises(InputError, match=r"no white pixel|background"):
        read_episode_image(episode.folder, episode.file_names[0], episode.camera)


def test_the_next_episode_takes_the_camera_of_the_last(made):
    capture, sources = made
    given = dataclasses.replace(sources, offset=EPOCH + 0.37, exact=True)
    add_episode(capture, given, name="first")
    second = add_episode(capture, dataclasses.replace(given, camera=None, start=0.19, end=1.01))
    assert second.folder.name == "0000"
    assert second.images == 25
    (camera, X_WC), (other, X_WQ) = (read_fixed_camera(path) for path in (second.folder, capture / "episodes/first"))
    np.testing.assert_array_equal(camera.intrinsics, other.intrinsics)
    np.testing.assert_allclose([*X_WC.p, *X_WC.q], [*X_WQ.p, *X_WQ.q], atol=1e-12)
    assert second.clock.residual is None


def test_masks_come_from_a_folder(push, made, tmp_path):
    capture, sources = made
    (tmp_path / "masks").mkdir()
    for k in range(len(push.t)):
        mask = np.zeros((240, 320), np.uint8)
        mask[100:140, 50 + k : 90 + k] = 255
        cv2.imwrite(str(tmp_path / f"masks/{k}.png"), mask)
    given = dataclasses.replace(sources, offset=EPOCH + 0.37, exact=True, masks=tmp_path / "masks", start=0.0)
    added = add_episode(capture, given)
    assert added.masked
    episode = read_episode(load_capture(capture), "0000")
    _, mask = read_episode_image(episode.folder, episode.file_names[7], episode.camera)
    assert mask[120].nonzero()[0].tolist() == list(range(57, 97))
    (tmp_path / "masks/3.png").unlink()
    with pytest.raises(InputError, match="got 47 masks; allowed: 48, one for each frame"):
        add_episode(capture, given)


def test_frames_outside_of_the_log_are_dropped(push, made, tmp_path):
    capture, sources = made
    rows = (tmp_path / "robot.csv").read_text().splitlines()
    (tmp_path / "robot.csv").write_text("\n".join([rows[0], *rows[1 + 150 :]]) + "\n")  # from 0.2 s of the film on
    added = add_episode(capture, dataclasses.replace(sources, offset=EPOCH + 0.37, exact=True))
    assert "6 frames outside of the log dropped" in added.clock.notes
    assert added.images == len(push.t) - 6


@pytest.mark.parametrize(
    ("level", "words"),
    [(1, "masks whose largest value is 1; allowed: 0, and 128 to 255"), (0, "largest value is 0"), (127, "is 127")],
)
def test_a_film_of_masks_without_white_is_refused(push, made, tmp_path, level, words):
    capture, sources = made
    (tmp_path / "masks").mkdir()
    for k in range(len(push.t)):
        mask = np.zeros((240, 320), np.uint8)
        mask[100:140, 50:90] = level
        cv2.imwrite(str(tmp_path / f"masks/{k}.png"), mask)
    with pytest.raises(InputError, match=words):
        add_episode(capture, dataclasses.replace(sources, offset=EPOCH + 0.37, exact=True, masks=tmp_path / "masks"))
    assert load_capture(capture).episode_names == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"offset": 0.0, "exact": True}, "0 frames within the log's"),
        ({"camera": None}, "no episode whose camera could be taken"),
        ({"columns": "t=stamp[ms],px=x[mm],py=y[mm],pz=up[mm]"}, "no column up for pz"),
        ({"start": 5.0}, "0 frames of a film of 1.567 s"),
    ],
)
def test_what_does_not_fit_is_refused_and_leaves_nothing(made, change, words):
    capture, sources = made
    with pytest.raises(InputError, match=words):
        add_episode(capture, dataclasses.replace(sources, **change))
    assert load_capture(capture).episode_names == []


def test_a_wrong_map_is_refused_first(made):
    with pytest.raises(ParameterError, match="--columns"):
        add_episode(made[0], dataclasses.replace(made[1], columns="x"))
