# SPDX-License-Identifier: MIT
"""Films and logs in data sets of LeRobot, layouts v2 and v3; needs `pyarrow`.

meta/info.json                                   fps, features, patterns of file names
v2  data/chunk-000/episode_000000.parquet        a row for each frame
videos/chunk-000/KEY/episode_000000.mp4
v3  data/chunk-000/file-000.parquet              rows of several episodes
videos/KEY/chunk-000/file-000.mp4            films of several episodes
meta/episodes/chunk-000/file-000.parquet     where in them each episode lies
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pinwm_drake.capture.importers.film import Columns, Film, in_order
from pinwm_drake.capture.importers.video import read_video
from pinwm_drake.capture.paths import is_file, require_file
from pinwm_drake.documents import Entry, read_json
from pinwm_drake.errors import InputError, require_package
from pinwm_drake.reading.contents import guarded, require_contents

INFO, EPISODES = "meta/info.json", "meta/episodes"
_V2 = (
    "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
    "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
)
_V3 = (
    "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
)
_MOST_BYTES = 2**36
_OWN = ("timestamp", "frame_index", "episode_index", "index", "task_index")


@dataclass(frozen=True, eq=False)
class _DataSet:
    """Data set, one of its episodes, and where this lies."""

    folder: Path
    info: Entry
    number: int
    row: dict[str, Any]  # of meta/episodes; empty in v2

    @property
    def features(self) -> dict[str, dict[str, Any]]:
        """What info.json says of each feature."""
        found: dict[str, dict[str, Any]] = {}
        entry = self.info["features"]
        for name in entry.value if isinstance(entry.value, dict) else []:
            if not isinstance(about := entry[name].value, dict):
                raise entry[name].refusal("a mapping with dtype")
            found[name] = about
        if not found:
            raise entry.refusal("a mapping with features")
        return found

    def place(self, key: str) -> float:
        """Number in the episode's row of meta/episodes; 0 in v2."""
        value = self.row.get(key) if self.row else 0
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < 1e9:
            raise InputError(self.folder / EPISODES, value=f"{key} = {value!a}", allowed="a number from 0")
        return value

    def file(self, key: str, part: str, video_key: str = "") -> Path:
        """File of the episode's data or film, by a key of info.json and the beginning of its columns in v3."""
        index = ("data_path", "video_path").index(key)
        entry = self.info.find(key)
        pattern = (_V3 if self.row else _V2)[index] if entry is None or entry.value is None else entry.text()
        size = self.info.find("chunks_size")
        numbers = {
            "episode_chunk": self.number // (1000 if size is None else size.integer(1, 10**9)),
            "episode_index": self.number,
            "chunk_index": int(self.place(f"{part}/chunk_index")),
            "file_index": int(self.place(f"{part}/file_index")),
        }
        with guarded(self.info.path, f"a pattern of file names for {key}"):
            name = pattern.format(video_key=video_key, **numbers)
        file = require_file(self.folder / name, f"the file of episode {self.number} that {INFO} names")
        return require_contents(file, _MOST_BYTES)


def is_lerobot(path: Path) -> bool:
    """Flag: a path is a data set of LeRobot."""
    return is_file(path / INFO)


def read_lerobot_film(path: Path, number: int = 0, key: str | None = None) -> Film:
    """Read the stamps of an episode's film, whose clock is that of its rows.

    Args:
        path: The data set.
        number: Number of the episode.
        key: Feature that is the camera; None for the only one.

    Raises:
        InputError: A file is missing or cannot be read, or there is no such episode or camera.
        ParameterError: pyarrow is not installed.
    """
    data = _open(path, number)
    cameras = [name for name, about in data.features.items() if about.get("dtype") in ("video", "image")]
    if key is None and len(cameras) == 1:
        key = cameras[0]
    if key not in cameras:
        found = f"camera {key!a}" if key else f"{len(cameras)} cameras"
        raise InputError(path / INFO, value=found, allowed=f"--topic with one of {', '.join(cameras)}")
    t = _numbers(data, _table(data, ["timestamp"]), "timestamp")
    kept, told = in_order(path, t, "frame")
    if data.features[key].get("dtype") == "image":
        return Film(path, t[kept], True, lambda numbers: _images(data, key, kept[list(numbers)]), tuple(told))
    film = read_video(data.file("video_path", f"videos/{key}", key))
    wanted = t[kept] + data.place(f"videos/{key}/from_timestamp")
    # Each row has the frame whose stamp is nearest.
    after = np.clip(np.searchsorted(film.t, wanted), 1, len(film.t) - 1)
    numbers = after - (wanted - film.t[after - 1] <= film.t[after] - wanted)
    apart = np.abs(film.t[numbers] - wanted)
    far = apart > 0.5 / film.rate
    notes = [*told, *([f"{int(far.sum())} rows without a frame dropped"] if far.any() else [])]
    if (~far).sum() < 2:
        raise InputError(film.path, value="stamps that none of the rows have", allowed="the film of this episode")
    chosen = numbers[~far]

    def frames(wanted: Sequence[int]) -> Iterator[np.ndarray]:
        return film.frames(chosen[list(wanted)].tolist())

    return Film(path, t[kept][~far], True, frames, tuple(notes))


def read_lerobot_log(path: Path, number: int = 0) -> Columns:
    """Read the numbers of an episode's rows; of vectors, columns FEATURE.NAME or FEATURE.0, FEATURE.1 and so on.

    Raises:
        InputError: A file is missing or cannot be read, or there is no such episode.
        ParameterError: pyarrow is not installed.
    """
    data = _open(path, number)
    wanted = [name for name, about in data.features.items() if about.get("dtype") not in ("video", "image", "string")]
    table = _table(data, [*dict.fromkeys([*_OWN, *wanted])])
    values: dict[str, np.ndarray] = {}
    for name in table.column_names:
        rows = _numbers(data, table, name)
        if rows.ndim == 1:
            values[name] = rows
            continue
        flat = rows.reshape(len(rows), -1)
        with guarded(path / INFO, f"names of the elements of {name}"):
            names = data.features.get(name, {}).get("names")
            names = next(iter(names.values())) if isinstance(names, dict) else names
            names = names if isinstance(names, list) and len(names) == flat.shape[1] else range(flat.shape[1])
            values |= {f"{name}.{one}": flat[:, k] for k, one in enumerate(names)}
            values |= {f"{name}.{k}": flat[:, k] for k in range(flat.shape[1])}
    return Columns(path, values, np.arange(1, len(table) + 1), "timestamp")


def _open(path: Path, number: int) -> _DataSet:
    require_package("pyarrow", "lab", "data sets of LeRobot")
    info, row = read_json(path / INFO), dict[str, Any]()
    files = sorted((path / EPISODES).rglob("*.parquet"))
    if files:
        import pyarrow.parquet

        found: list[dict[str, Any]] = []
        for file in files:
            with guarded(file, "a whole parquet file"):
                require_contents(file, _MOST_BYTES)
                names = [one for one in pyarrow.parquet.read_schema(file).names if not one.startswith("stats/")]
                filters = [("episode_index", "=", number)]
                found += pyarrow.parquet.read_table(file, columns=names, filters=filters).to_pylist()
        if not found:
            raise InputError(path, value=f"no episode {number}", allowed="--number of an episode of this data set")
        row = found[0]
    return _DataSet(path, info, number, row)


def _table(data: _DataSet, columns: list[str]) -> Any:
    """Rows of the episode, in order, with those columns that the file has."""
    import pyarrow.parquet

    file = data.file("data_path", "data")
    with guarded(file, "a whole parquet file"):
        names = pyarrow.parquet.read_schema(file).names
        table = pyarrow.parquet.read_table(
            file,
            columns=[name for name in columns if name in names],
            filters=[("episode_index", "=", data.number)] if "episode_index" in names else None,
        )
    if len(table) < 2:
        raise InputError(file, value=f"{len(table)} rows of episode {data.number}", allowed="two or more")
    return table


def _numbers(data: _DataSet, table: Any, name: str) -> np.ndarray:
    """Numbers (rows, ...) of a column, one in a row of those that each data set has; NaN for none."""
    if name not in table.column_names:
        raise InputError(data.folder / INFO, value=f"no column {name}", allowed="a data set of LeRobot, v2 or v3")
    with guarded(data.folder / INFO, f"numbers in feature {name}"):
        numbers = np.array(table[name].to_pylist(), float)
        return numbers.reshape(len(table)) if name in _OWN else numbers


def _images(data: _DataSet, key: str, rows: np.ndarray) -> Iterator[np.ndarray]:
    table, allowed = _table(data, [key]), "PNG or JPEG in each row"
    for row in rows.tolist():
        with guarded(data.folder, f"{allowed} of {key}"):
            content = table[key][row].as_py()["bytes"]
            picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        if picture is None:
            raise InputError(data.folder, row=row + 1, value=f"no image in {key}", allowed=allowed)
        yield cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
