# SPDX-License-Identifier: MIT
import json
import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pinwm_drake.capture.importers.columns import make_trajectory, parse_columns
from pinwm_drake.capture.importers.recordings import read_film, read_log
from pinwm_drake.errors import InputError
from tests.capture.test_video import LOSS, plain, write_mp4

RATE, KEY = 25.0, "observation.images.front"
FEATURES = {
    "timestamp": {"dtype": "float32", "shape": [1]},
    "observation.state": {"dtype": "float32", "shape": [3], "names": ["x", "y", "z"]},
    KEY: {"dtype": "video", "shape": [48, 64, 3]},
}


def rows(episode: int, count: int):
    t = (np.arange(count) / RATE).astype(np.float32)
    state = [[0.01 * k, 0.1 * episode, 0.03] for k in range(count)]
    return {"timestamp": t, "episode_index": [episode] * count, "observation.state": state}


def write_info(folder, version, **more):
    (folder / "meta").mkdir(parents=True)
    info = {"codebase_version": version, "fps": RATE, "features": FEATURES, "chunks_size": 1000, **more}
    (folder / "meta/info.json").write_text(json.dumps(info))


def write_v2(folder):
    """Two episodes of 6 frames, each in files of its own."""
    write_info(
        folder,
        "v2.1",
        data_path="data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        video_path="videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
    )
    for episode in range(2):
        data, film = folder / "data/chunk-000", folder / "videos/chunk-000" / KEY
        data.mkdir(parents=True, exist_ok=True)
        film.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table(rows(episode, 6)), data / f"episode_{episode:06}.parquet")
        write_mp4(film / f"episode_{episode:06}.mp4", 6 if episode == 0 else 12, RATE)
    return folder


def write_v3(folder):
    """Episodes of 4 and 6 frames in one file of data and one film."""
    write_info(
        folder,
        "v3.0",
        data_path="data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        video_path="videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    )
    for part in ("data/chunk-000", f"videos/{KEY}/chunk-000", "meta/episodes/chunk-000"):
        (folder / part).mkdir(parents=True)
    table = pa.concat_tables([pa.table(rows(0, 4)), pa.table(rows(1, 6))])
    pq.write_table(table, folder / "data/chunk-000/file-000.parquet")
    write_mp4(folder / f"videos/{KEY}/chunk-000/file-000.mp4", 10, RATE)
    where = {
        "episode_index": [0, 1],
        "data/chunk_index": [0, 0],
        "data/file_index": [0, 0],
        f"videos/{KEY}/chunk_index": [0, 0],
        f"videos/{KEY}/file_index": [0, 0],
        f"videos/{KEY}/from_timestamp": [0.0, 4 / RATE],
        f"videos/{KEY}/to_timestamp": [4 / RATE, 10 / RATE],
        "length": [4, 6],
    }
    pq.write_table(pa.table(where), folder / "meta/episodes/chunk-000/file-000.parquet")
    return folder


@pytest.mark.parametrize("write", [write_v2, write_v3])
def test_an_episode_has_its_film_and_its_log(tmp_path, write):
    folder = write(tmp_path / "set")
    film, log = read_film(folder, number=1), read_log(folder, number=1)
    np.testing.assert_allclose(film.t, np.arange(6) / RATE, atol=1e-6)
    first = 4 if write is write_v3 else 0
    means = [frame.mean() for frame in film.frames([0, 5])]
    np.testing.assert_allclose(means, [plain(20 * first).mean(), plain(20 * (first + 5)).mean()], atol=LOSS)
    text = "px=observation.state.x,py=observation.state[1],pz=observation.state.z"
    motion, _ = make_trajectory(log, parse_columns(text))
    np.testing.assert_allclose(motion.t, film.t, atol=1e-6)
    np.testing.assert_allclose(motion.p_WP, [[0.01 * k, 0.1, 0.03] for k in range(6)], atol=1e-7)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda folder: None, "allowed: --number of an episode"),
        (lambda folder: (folder / "data/chunk-000/file-000.parquet").unlink(), "the file of episode 1 that meta/info"),
        (lambda folder: (folder / "data/chunk-000/file-000.parquet").write_bytes(b"PAR1"), "a whole parquet file"),
    ],
)
def test_a_set_that_cannot_be_read_is_refused(tmp_path, change, words):
    folder = write_v3(tmp_path / "set")
    change(folder)
    with pytest.raises(InputError, match=re.escape(words)):
        read_film(folder, number=7 if "number" in words else 1)


def edit_info(**values):
    def change(folder):
        document = json.loads((folder / "meta/info.json").read_text())
        (folder / "meta/info.json").write_text(json.dumps(document | values))

    return change


def edit_table(name, **columns):
    def change(folder):
        table = pq.read_table(folder / name).to_pydict() | columns
        pq.write_table(pa.table({key: value for key, value in table.items() if value is not None}), folder / name)

    return change


DATA, EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (edit_info(features=[1]), "features = [1]; allowed: a mapping with features"),
        (edit_info(features={KEY: 3}), f"features.{KEY} = 3; allowed: a mapping with dtype"),
        (edit_info(chunks_size="x"), 'chunks_size = "x"; allowed: a whole number'),
        (edit_info(data_path="{nobody}"), "a pattern of file names for data_path"),
        (edit_info(data_path=7), "data_path = 7; allowed: text"),
        (edit_table(DATA, timestamp=None), "no column "),
        (edit_table(DATA, timestamp=["x"] * 10), "numbers in feature timestamp"),
        (edit_table(DATA, timestamp=[[0.0, 1.0]] * 10), "numbers in feature timestamp"),
        (edit_table(EPISODES, **{"data/chunk_index": None}), "data/chunk_index = None; allowed: a number from 0"),
        (edit_table(EPISODES, **{"data/file_index": ["a", "b"]}), "data/file_index = 'b'; allowed: a number from 0"),
        (edit_table(EPISODES, episode_index=None), "a whole parquet file"),
    ],
)
@pytest.mark.parametrize("read", [read_film, lambda *args, **more: make_trajectory(read_log(*args, **more), {})])
def test_damaged_sets_are_refused_by_name(tmp_path, change, words, read):
    folder = write_v3(tmp_path / "set")
    change(folder)
    with pytest.raises(InputError, match=re.escape(words)):
        read(folder, number=1)


def test_a_frame_with_no_place_in_its_film_is_refused(tmp_path):
    folder = write_v3(tmp_path / "set")
    edit_table(EPISODES, **{f"videos/{KEY}/from_timestamp": [0.0, None]})(folder)
    with pytest.raises(InputError, match=f"videos/{KEY}/from_timestamp = None; allowed: a number"):
        read_film(folder, number=1)


def test_each_row_has_the_nearest_frame_and_others_are_dropped(tmp_path):
    folder = write_v3(tmp_path / "set")
    t = np.arange(10) / RATE
    t[4:] = np.array([0.0, 0.01, 0.05, 0.07, 0.12, 0.9])
    edit_table(DATA, timestamp=t.tolist())(folder)
    film = read_film(folder, number=1)  # frames 4 to 9 are at 0, 0.04 and so on
    np.testing.assert_allclose(film.t, [0.0, 0.01, 0.05, 0.07, 0.12])
    assert film.notes[-1] == "1 rows without a frame dropped"
    means = [frame.mean() for frame in film.frames(range(5))]
    np.testing.assert_allclose(means, [plain(20 * k).mean() for k in (4, 4, 5, 6, 7)], atol=LOSS)


def test_a_camera_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match=f"camera 'x'; allowed: --topic with one of {KEY}"):
        read_film(write_v2(tmp_path / "set"), topic="x")
