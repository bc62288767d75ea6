# SPDX-License-Identifier: MIT
import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pinwm_drake.capture.importers.recordings import read_film, read_log
from pinwm_drake.errors import InputError

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
START = 1_700_000_000_000_000_000  # ns


def header(k: int, late: int = 0):
    time = START + k * 20_000_000 + late
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=time // 10**9, nanosec=time % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="world")


def vector(x, y, z, kind="Vector3"):
    return TYPES[f"geometry_msgs/msg/{kind}"](x=float(x), y=float(y), z=float(z))


def turn():
    return TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)


def picture(k: int) -> np.ndarray:
    image = np.zeros((12, 16, 3), np.uint8)
    image[..., 0] = 20 * k
    return image


def raw(k: int):
    data = np.pad(picture(k).reshape(12, 48), ((0, 0), (0, 4))).ravel()  # rows of 52 bytes
    kind = TYPES["sensor_msgs/msg/Image"]
    return kind(header(k), height=12, width=16, encoding="rgb8", is_bigendian=0, step=52, data=data)


def compressed(k: int):
    coded = cv2.imencode(".png", picture(k)[..., ::-1])[1].ravel()
    return TYPES["sensor_msgs/msg/CompressedImage"](header(k), format="png", data=coded)


def pose(k: int):
    place = TYPES["geometry_msgs/msg/Pose"](vector(0.01 * k, 0, 0.03, "Point"), turn())
    return TYPES["geometry_msgs/msg/PoseStamped"](header(k), place)


def twist(k: int):
    both = TYPES["geometry_msgs/msg/Twist"](linear=vector(0.5, 0, 0), angular=vector(0, 0, 0))
    return TYPES["geometry_msgs/msg/TwistStamped"](header(k, 10_000_000), both)


def tree(k: int):
    def one(name: str, x: float):
        move = TYPES["geometry_msgs/msg/Transform"](vector(x, 0, 0), turn())
        return TYPES["geometry_msgs/msg/TransformStamped"](header(k), name, move)

    return TYPES["tf2_msgs/msg/TFMessage"]([one("elbow", 7.0), one("tool", 0.02 * k)])


TOPICS = {
    "/camera": ("sensor_msgs/msg/Image", raw),
    "/small": ("sensor_msgs/msg/CompressedImage", compressed),
    "/pose": ("geometry_msgs/msg/PoseStamped", pose),
    "/twist": ("geometry_msgs/msg/TwistStamped", twist),
    "/tf": ("tf2_msgs/msg/TFMessage", tree),
}


def write_bag(path, topics=tuple(TOPICS), storage=StoragePlugin.SQLITE3, twists=range(10)):
    with Writer(path, version=9, storage_plugin=storage) as writer:
        for topic in topics:
            kind, make = TOPICS[topic]
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for k in twists if topic == "/twist" else range(10):
                message = STORE.serialize_cdr(make(k), kind)
                writer.write(connection, START + k * 20_000_000 + 5_000_000, message)
    return path


@pytest.fixture(params=[StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def bag(tmp_path, request):
    return write_bag(tmp_path / "bag", storage=request.param)


@pytest.mark.parametrize("topic", ["/camera", "/small"])
def test_images_have_the_stamps_of_their_headers(bag, topic):
    film = read_film(bag, topic=topic)
    np.testing.assert_allclose(film.t - 1.7e9, 0.02 * np.arange(10), atol=1e-6)
    assert film.shared
    for frame, k in zip(film.frames([0, 3, 9]), (0, 3, 9), strict=True):
        np.testing.assert_array_equal(frame, picture(k))


def test_poses_and_velocities_become_columns(bag):
    table = read_log(bag, topic="/pose,/twist")
    np.testing.assert_allclose(table.values["px"], 0.01 * np.arange(10))
    np.testing.assert_allclose(table.values["qw"], 1)
    np.testing.assert_allclose(table.values["vx"], 0.5)
    assert table.time == "t"


def test_poses_without_a_velocity_beside_them_are_dropped_and_told(tmp_path):
    table = read_log(write_bag(tmp_path / "bag", twists=range(3, 7)), topic="/pose,/twist")
    assert table.rows.tolist() == [4, 5, 6, 7, 8]  # velocities are 5 ms late
    np.testing.assert_allclose(table.values["px"], 0.01 * np.arange(3, 8))
    assert table.notes[-1] == "5 rows outside of /twist dropped"


def test_a_frame_of_the_tree_is_a_log(bag):
    np.testing.assert_allclose(read_log(bag, topic="/tf:tool").values["px"], 0.02 * np.arange(10))


def test_a_single_mcap_file_is_read(tmp_path):
    bag = write_bag(tmp_path / "bag", ("/camera", "/pose"), StoragePlugin.MCAP)
    (file,) = bag.glob("*.mcap")
    assert len(read_film(file).t) == 10
    assert len(read_log(file).values["px"]) == 10


def test_of_several_topics_one_has_to_be_named(bag):
    with pytest.raises(InputError, match="2 topics; allowed: --topic with one of /camera, /small"):
        read_film(bag)
    with pytest.raises(InputError, match="topic '/x'; allowed: --log-topic with one of /pose"):
        read_log(bag, topic="/x")
    with pytest.raises(InputError, match="no message of /tf with child frame hand"):
        read_log(bag, topic="/tf:hand")


def test_a_damaged_bag_is_refused(bag):
    for file in bag.glob("*.*"):
        file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(InputError, match="bag"):
        read_film(bag, topic="/camera")
