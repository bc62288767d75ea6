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
from pinwm_drake.reading.contents import guarded

INFO = "meta/info.json"
_V2 = (
    "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
    "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
)
_V3 = (
    "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
)
_OWN = ("timestamp", "frame_index", "episode_index", "index", "task_index")


@dataclass(frozen=True, eq=False)
class _DataSet:
    """Data set, one of its episodes, and where this lies."""

    folder: Path
    info: Entry
    number: int
    row: dict[str, Any]  # of meta/episodes; empty in v2

    @property
    def features(self) -> dict[str, Any]:
        found = self.info["features"].value
        return found if isinstance(found, dict) else {}

    def file(self, key: str, part: str, video_key: str = "") -> Path:
        """File of the episode's data or film, by a key of info.json and the beginning of its columns in v3."""
        index = ("data_path", "video_path").index(key)
        entry = self.info.find(key)
        pattern = (_V3 if self.row else _V2)[index] if entry is None or entry.value is None else entry.text()
        size = self.info.find("chunks_size")
        chunk = self.number // max(int(size.value) if size is not None else 1000, 1)
        with guarded(self.info.path, f"a pattern of file names for {key}"):
            name = pattern.format(
                episode_chunk=chunk,
                episode_index=self.number,
                video_key=video_key,
                chunk_index=int(self.row.get(f"{part}/chunk_index", 0)),
                file_index=int(self.row.get(f"{part}/file_index", 0)),
            )
        return require_file(self.folder / name, f"the file of episode {self.number} that {INFO} names")


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
    t = _table(data, ["timestamp"])["timestamp"].to_numpy()
    kept, told = in_order(path, np.asarray(t, float), "frame")
    if data.features[key].get("dtype") == "image":
        return Film(path, t[kept], True, lambda numbers: _images(data, key, kept[list(numbers)]), tuple(told))
    film = read_video(data.file("video_path", f"videos/{key}", key))
    start = float(data.row.get(f"videos/{key}/from_timestamp", 0.0))
    # Each row has the frame whose stamp is nearest.
    numbers = np.abs(film.t[None] - (t[kept] + start)[:, None]).argmin(1)
    apart = np.abs(film.t[numbers] - t[kept] - start)
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
        with guarded(path / INFO, f"numbers in feature {name}"):
            rows = np.array(table[name].to_pylist(), float)
            if rows.ndim == 1:
                values[name] = rows
                continue
            flat = rows.reshape(len(rows), -1)
            names = data.features.get(name, {}).get("names")
            names = next(iter(names.values())) if isinstance(names, dict) else names
            names = names if isinstance(names, list) and len(names) == flat.shape[1] else range(flat.shape[1])
            values |= {f"{name}.{one}": flat[:, k] for k, one in enumerate(names)}
            values |= {f"{name}.{k}": flat[:, k] for k in range(flat.shape[1])}
    if "timestamp" not in values:
        raise InputError(path / INFO, value="no column timestamp", allowed="a data set of LeRobot, v2 or v3")
    return Columns(path, values, np.arange(1, len(table) + 1), "timestamp")


def _open(path: Path, number: int) -> _DataSet:
    require_package("pyarrow", "lab", "data sets of LeRobot")
    info, row = read_json(path / INFO), dict[str, Any]()
    files = sorted((path / "meta/episodes").rglob("*.parquet"))
    if files:
        import pyarrow.parquet

        found: list[dict[str, Any]] = []
        for file in files:
            with guarded(file, "a whole parquet file"):
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


def _images(data: _DataSet, key: str, rows: np.ndarray) -> Iterator[np.ndarray]:
    column = _table(data, [key])[key]
    for row in rows.tolist():
        content = (column[row].as_py() or {}).get("bytes")
        picture = None if content is None else cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        if picture is None:
            raise InputError(data.folder, row=row + 1, value=f"no image in {key}", allowed="PNG or JPEG in each row")
        yield cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
