# SPDX-License-Identifier: MIT
"""Films and logs in recordings of ROS: rosbag2 folders, MCAP and db3 files, and bags of ROS 1; needs `rosbags`.

Stamps are those of the messages' headers, or where these are zero, the times at which messages were recorded.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from pinwm_drake.capture.importers.film import Columns, Film, counted, in_order
from pinwm_drake.capture.paths import is_folder
from pinwm_drake.documents import read_yaml
from pinwm_drake.errors import InputError, require_package
from pinwm_drake.reading.contents import guarded, require_contents

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

METADATA = "metadata.yaml"
BAG_SUFFIXES = (".mcap", ".db3", ".bag")
_PICTURES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_POSES = (
    *("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PointStamped"),
    *("geometry_msgs/msg/TransformStamped", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"),
)
_OTHERS = ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/WrenchStamped")
# Encodings of raw images, with the number of channels and what turns them into RGB or RGBA; None for as they are.
_ENCODINGS = {
    **dict.fromkeys(("rgb8", "8UC3"), (3, None)),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    **dict.fromkeys(("rgba8", "8UC4"), (4, None)),
    "bgra8": (4, cv2.COLOR_BGRA2RGBA),
    **dict.fromkeys(("mono8", "8UC1"), (1, cv2.COLOR_GRAY2RGB)),
    **{f"bayer_{name}8": (1, code) for name, code in (
        ("rggb", cv2.COLOR_BAYER_BG2RGB), ("bggr", cv2.COLOR_BAYER_RG2RGB),
        ("gbrg", cv2.COLOR_BAYER_GR2RGB), ("grbg", cv2.COLOR_BAYER_GB2RGB),
    )},
}  # fmt: skip
_MOST_BYTES = 2**40
_ALLOWED = "a recording of ROS that rosbags reads"


def read_bag_film(path: Path, topic: str | None = None) -> Film:
    """Read the stamps of a topic of images, raw or compressed; they are decoded when they are asked for.

    Args:
        path: The recording.
        topic: Name of the topic; None for the only one.

    Raises:
        InputError: The recording cannot be read, or has no such topic.
        ParameterError: rosbags is not installed.
    """
    with _reader(path) as reader:
        (connection,) = _chosen(path, reader, _PICTURES, topic, "--topic")
        t, notes = _stamps(reader, connection)
    kept, told = in_order(path, t, "frame")

    def frames(numbers: Sequence[int]) -> Iterator[np.ndarray]:
        wanted, last = set(kept[list(numbers)].tolist()), int(kept[max(numbers)])
        with _reader(path) as reader:
            (connection,) = _chosen(path, reader, _PICTURES, topic, "--topic")
            for k, (_, _, raw) in enumerate(reader.messages(connections=[connection])):
                if k in wanted:
                    yield _picture(path, k + 1, reader.deserialize(raw, connection.msgtype))
                if k == last:
                    return

    return Film(path, t[kept], True, frames, (*notes, *told))


def read_bag_log(path: Path, topics: str | None = None) -> Columns:
    """Read poses of the pusher, and velocities and forces, from topics of a recording.

    Columns are t, px to pz, qw to qz, vx to vz and fx to fz, as far as the topics have them. The stamps are those of
    the first topic; others are interpolated, and rows more than an interval before or after these are
    dropped.

    Args:
        path: The recording.
        topics: Names with commas between them, that of poses first; of transforms as TOPIC:CHILD_FRAME. None for the
            only topic of poses.

    Raises:
        InputError: The recording cannot be read, or has no such topic.
        ParameterError: rosbags is not installed.
    """
    names = [None] if topics is None else [name.strip() for name in topics.split(",")]
    values: dict[str, np.ndarray] = {}
    notes: list[str] = []
    with _reader(path) as reader:
        for name in names:
            topic, _, child = (name or "").partition(":")
            kinds = _POSES if name is None else _POSES + _OTHERS
            (connection,) = _chosen(path, reader, kinds, topic or None, "--log-topic")
            table, told = _numbers(path, reader, connection, child)
            notes += told
            if not values:
                values, rows = table, np.arange(1, len(table["t"]) + 1)
                continue
            t, order = values["t"], np.argsort(table["t"], kind="stable")
            slack = float(np.ptp(table["t"])) / max(len(order) - 1, 1)
            inside = (t >= table["t"].min() - slack) & (t <= table["t"].max() + slack)
            notes += [f"{counted(int((~inside).sum()), 'row')} outside of {topic} dropped"] if not inside.all() else []
            more = {key: np.interp(t, table["t"][order], one[order]) for key, one in table.items() if key not in values}
            rows, values = rows[inside], {key: one[inside] for key, one in (values | more).items()}
    return Columns(path, values, rows, "t", tuple(notes), si=True)


@contextmanager
def _reader(path: Path) -> "Iterator[AnyReader]":
    require_package("rosbags", "lab", "recordings of ROS")
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    if is_folder(path):  # rosbags would follow each alias, and wait for pipes
        about = read_yaml(path / METADATA)["rosbag2_bagfile_information"]["relative_file_paths"]
        files = [path / Path(one.text()).name for one in about.items()]
    else:
        files = [path]
    for file in files:
        require_contents(file, _MOST_BYTES)
    with guarded(path, _ALLOWED), AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        yield reader


def _chosen(
    path: Path, reader: "AnyReader", kinds: tuple[str, ...], topic: str | None, option: str
) -> "list[Connection]":
    """Return the connection of a topic in a list; that of the only topic of some kinds where there is no name."""
    fitting = [one for one in reader.connections if one.msgtype in kinds]
    found = [one for one in fitting if topic is None or one.topic == topic]
    if len(found) == 1:
        return found
    names = ", ".join(one.topic for one in fitting[:8])
    if not fitting:
        short = ", ".join(kind.rpartition("/")[2] for kind in kinds)
        raise InputError(path, value="no topic with messages that can be used", allowed=f"messages {short}")
    given = f"topic {topic!a}" if topic else f"{len(found)} topics"
    raise InputError(path, value=given, allowed=f"{option} with one of {names}")


def _stamps(reader: "AnyReader", connection: "Connection") -> tuple[np.ndarray, list[str]]:
    """Stamps (n,) [s] of the messages of a topic."""
    headers, recorded = [], []
    for _, time, raw in reader.messages(connections=[connection]):
        message: Any = reader.deserialize(raw, connection.msgtype)
        headers.append(_stamp(message))
        recorded.append(1e-9 * time)
    return _of_headers(np.array(headers), np.array(recorded), connection.topic)


def _of_headers(headers: np.ndarray, recorded: np.ndarray, topic: str) -> tuple[np.ndarray, list[str]]:
    if (headers > 0).all():
        return headers, []
    return recorded, [f"{topic}: headers without stamps; the times of recording are taken"]


def _stamp(message: Any) -> float:
    header = getattr(message, "header", None)
    return 0.0 if header is None else header.stamp.sec + 1e-9 * header.stamp.nanosec


def _picture(path: Path, number: int, message: Any) -> np.ndarray:
    """Picture (H, W, 3 or 4) uint8 of a message."""
    if hasattr(message, "format"):
        picture = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        if picture is None:
            raise InputError(path, row=number, value=f"an image of format {message.format}", allowed="JPEG or PNG")
        return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    if message.encoding not in _ENCODINGS:
        raise InputError(path, row=number, value=f"encoding {message.encoding}", allowed=", ".join(_ENCODINGS))
    channels, code = _ENCODINGS[message.encoding]
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    picture = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    return np.ascontiguousarray(picture) if code is None else cv2.cvtColor(np.ascontiguousarray(picture), code)


def _numbers(
    path: Path, reader: "AnyReader", connection: "Connection", child: str
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns of a topic of poses, velocities or forces."""
    rows: list[dict[str, float]] = []
    recorded, headers = [], []
    for _, time, raw in reader.messages(connections=[connection]):
        message: Any = reader.deserialize(raw, connection.msgtype)
        for part in _parts(message, child):
            rows.append(_values(part))
            headers.append(_stamp(part))
            recorded.append(1e-9 * time)
    if not rows:
        found = f"no message of {connection.topic}" + (f" with child frame {child}" if child else "")
        raise InputError(path, value=found, allowed="a topic with messages; of transforms, TOPIC:CHILD_FRAME")
    t, notes = _of_headers(np.array(headers), np.array(recorded), connection.topic)
    return {"t": t, **{key: np.array([row[key] for row in rows]) for key in rows[0]}}, notes


def _parts(message: Any, child: str) -> list[Any]:
    if hasattr(message, "transforms"):
        return [one for one in message.transforms if one.child_frame_id.lstrip("/") == child.lstrip("/")]
    return [message]


def _values(message: Any) -> dict[str, float]:
    """Numbers of a message, by the capture's names."""
    found: dict[str, float] = {}
    pose, twist = getattr(message, "pose", None), getattr(message, "twist", None)
    pose, twist = getattr(pose, "pose", pose), getattr(twist, "twist", twist)
    place = getattr(message, "point", None) if pose is None else pose.position
    turn = None if pose is None else pose.orientation
    if hasattr(message, "transform"):
        place, turn = message.transform.translation, message.transform.rotation
    force = message.wrench.force if hasattr(message, "wrench") else None
    # An odometry has its twist in the axes of the body, which those of the world do not replace.
    speed = None if twist is None or pose is not None else twist.linear
    for prefix, vector in (("p", place), ("v", speed), ("f", force)):
        if vector is not None:
            found |= {f"{prefix}{axis}": float(getattr(vector, axis)) for axis in "xyz"}
    if turn is not None:
        found |= {f"q{axis}": float(getattr(turn, axis)) for axis in "wxyz"}
    return found
