# SPDX-License-Identifier: MIT
"""The station with a robot behind it: the ports, and what goes over LCM."""

import dataclasses
import io
import threading
import time

import numpy as np
import pytest
from drake import lcmt_drake_signal, lcmt_image, lcmt_image_array
from PIL import Image
from pydrake.common import RandomGenerator
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.systems.arm.messages import image_message
from pinwm_drake.systems.engines.engine import ContactForces
from pinwm_drake.systems.engines.lcm import receiver
from pinwm_drake.systems.engines.lcm.engine import LcmHandle
from pinwm_drake.systems.engines.lcm.link import make_lcm
from pinwm_drake.systems.engines.lcm.seal import Seal
from pinwm_drake.systems.engines.lcm.signal import signal_message
from pinwm_drake.systems.scenario.schema import LcmLink, load_scenario
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import make_station
from pinwm_drake.systems.view.meshcat import make_meshcat
from tests.systems.stations import FAR, REST, output, setup_of, station_of

LINK = LcmLink()
STATE = np.array([0.1, -0.2, 0.05, 0.0, 0.1, 0.0])


class Robot:
    """A station with the engine "lcm" that is told to move, its simulator, and the other end of the line."""

    def __init__(self, armed=False, key=None):
        self.lcm, self.commands, self.session = DrakeLcm("memq://"), [], 0.0
        self.raw, self.seal = [], None if key is None else Seal(key.read_bytes(), bytes(range(16, 32)))
        self.lcm.Subscribe(LINK.command_channel, lambda raw: self.commands.append(lcmt_drake_signal.decode(raw)))
        self.lcm.Subscribe(LINK.command_channel, self.raw.append)
        setup = setup_of()
        link = dataclasses.replace(setup.scenario.lcm, key_file=None if key is None else str(key))
        setup = dataclasses.replace(setup, scenario=dataclasses.replace(setup.scenario, lcm=link))
        self.station = make_station(setup, "lcm", lcm=self.lcm, armed=armed)
        self.tally = self.station.engine.handle.tally
        self.simulator = Simulator(self.station)
        self.context = self.simulator.get_mutable_context()
        self.station.GetInputPort("pusher_velocity_W").FixValue(self.context, [0.1, -0.05, 0.0])

    def begin(self, session):
        """What a controller does that is armed."""
        self.session = float(session)
        self.station.GetInputPort("session").FixValue(self.context, [self.session])

    def say(self, stamp, state=STATE, *, sequence=None, mode=0):
        message = lcmt_drake_signal()
        message.val = [*state, self.session, -1.0 if sequence is None else sequence, float(mode), 0.0]
        message.dim, message.coord = 10, [""] * 10
        message.timestamp = round(1e6 * stamp)
        self.publish(LINK.state_channel, message.encode())

    def show(self, stamp, picture):
        height, width, _ = picture.shape
        image = lcmt_image()
        image.width, image.height, image.row_stride = width, height, 4 * width
        image.size, image.data = picture.size, picture.tobytes()
        image.pixel_format, image.channel_type = lcmt_image.PIXEL_FORMAT_RGBA, lcmt_image.CHANNEL_TYPE_UINT8
        image.compression_method = lcmt_image.COMPRESSION_METHOD_NOT_COMPRESSED
        message = lcmt_image_array()
        message.header.utime = round(1e6 * stamp)
        message.num_images, message.images = 1, [image]
        self.publish(LINK.image_channel, message.encode())

    def publish(self, channel, message):
        self.lcm.Publish(channel, message if self.seal is None else self.seal.sign(channel, message))

    def read(self, name):
        return output(self.station, self.context, name)


def test_the_ports_are_those_of_every_engine():
    robot, twin = Robot(), station_of("twin")
    for count, get, more in (("num_input_ports", "get_input_port", 1), ("num_output_ports", "get_output_port", 0)):
        assert getattr(robot.station, count)() == getattr(twin, count)() + more
        for k in range(getattr(twin, count)()):
            mine, other = getattr(robot.station, get)(k), getattr(twin, get)(k)
            assert (mine.get_name(), mine.get_data_type()) == (other.get_name(), other.get_data_type())
            assert mine.size() == other.size()
    assert robot.station.GetInputPort("session").size() == 1
    assert output(twin, twin.CreateDefaultContext(), "fault") == ""


def test_what_a_robot_does_not_know_has_no_number():
    robot = Robot()
    robot.simulator.AdvanceTo(0.02)
    assert np.isnan(robot.read("object_state")).all()
    assert np.isnan(robot.read("pusher_state")).all()
    assert robot.read("rgb_time") == [-1.0]
    assert (robot.read("rgb").data == [255, 255, 255, 0]).all()
    assert robot.read("contact_forces").pairs == ContactForces.none().pairs
    assert robot.station.world is None


def test_what_comes_in():
    robot = Robot()
    robot.simulator.AdvanceTo(0.1)
    picture = np.full((80, 96, 4), 9, np.uint8)
    picture[:40, :, 3], picture[40:, :, 3] = 255, 0
    robot.say(1000.0)
    robot.show(999.97, picture)
    robot.simulator.AdvanceTo(0.15)
    assert (robot.read("pusher_state") == STATE).all()
    rgb = robot.read("rgb").data
    assert (rgb[:40] == [9, 9, 9, 255]).all()
    assert (rgb[40:] == [255, 255, 255, 0]).all()
    assert (robot.read("rgb_batch") == rgb[None]).all()
    assert abs(robot.read("pusher_time")[0] - 0.1) <= LINK.period + 1e-9
    assert robot.read("rgb_time")[0] == pytest.approx(robot.read("pusher_time")[0] - 0.03)
    # The pusher's geometry follows, and there is no object.
    inspector = robot.read("query_object").inspector()
    names = {inspector.GetName(frame).split("::")[-1]: frame for frame in inspector.GetAllFrameIds()}
    assert "object" not in names
    X_WP = robot.read("query_object").GetPoseInWorld(names["pusher"])
    assert np.abs(X_WP.translation() - STATE[:3]).max() < 1e-12
    # Nothing comes for longer than the time-out.
    robot.simulator.AdvanceTo(0.15 + LINK.timeout)
    assert np.isnan(robot.read("pusher_state")).all()
    assert abs(robot.read("rgb_time")[0] - 0.07) <= LINK.period + 1e-9


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda image: setattr(image, "width", 95), "image cannot be used: got 30720 bytes; allowed: 30400"),
        (lambda image: setattr(image, "data", image.data[:100]), "image cannot be used: got 100 bytes"),
        (lambda image: setattr(image, "pixel_format", lcmt_image.PIXEL_FORMAT_RGB), "image cannot be used: got pixel"),
        (lambda image: setattr(image, "compression_method", 1), "image cannot be used: got unreadable bytes"),
        (lambda image: setattr(image, "compression_method", 3), "image cannot be used: got unreadable PNG"),
        (lambda image: setattr(image, "compression_method", 2), "image cannot be used: got compression 2"),
    ],
)
def test_an_image_that_cannot_be_used_is_white_and_a_fault(spoil, words):
    robot = Robot()
    robot.say(1.0)
    message = lcmt_image_array.decode(image_message(np.zeros((80, 96, 4), np.uint8), 1.0).encode())
    message.images[0].data = np.zeros((80, 96, 4), np.uint8).tobytes()
    message.images[0].compression_method = 0
    spoil(message.images[0])
    message.images[0].size = len(message.images[0].data)
    robot.lcm.Publish(LINK.image_channel, message.encode())
    robot.simulator.AdvanceTo(0.02)
    assert robot.read("fault").startswith(words)
    assert (robot.read("rgb").data == [255, 255, 255, 0]).all()
    robot.show(1.02, np.zeros((80, 96, 4), np.uint8))
    robot.simulator.AdvanceTo(0.04)
    assert robot.read("fault") == ""


@pytest.mark.parametrize("channel", ["state_channel", "image_channel"])
def test_bytes_that_are_no_message_are_a_fault_until_one_comes(channel):
    robot, picture = Robot(), np.zeros((80, 96, 4), np.uint8)
    robot.say(1.0)
    robot.show(1.0, picture)
    robot.simulator.AdvanceTo(0.02)
    assert robot.read("fault") == ""
    robot.lcm.Publish(getattr(LINK, channel), b"garbage")
    robot.simulator.AdvanceTo(0.04)
    assert "cannot be read" in robot.read("fault")
    robot.say(1.04)
    robot.show(1.04, picture)
    robot.simulator.AdvanceTo(0.06)
    assert robot.read("fault") == ""


def test_an_image_of_another_size_is_a_fault_and_png_is_read():
    robot = Robot()
    robot.show(1.0, np.zeros((8, 9, 4), np.uint8))
    robot.simulator.AdvanceTo(0.02)
    assert robot.read("fault") == "image has 9 by 8 px; allowed: 96 by 80"
    picture = np.random.default_rng(0).integers(0, 255, (80, 96, 4), np.uint8)
    picture[..., 3] = 255
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG")
    message = lcmt_image_array.decode(image_message(picture, 1.05).encode())
    message.images[0].data, message.images[0].size = file.getvalue(), len(file.getvalue())
    message.images[0].compression_method = lcmt_image.COMPRESSION_METHOD_PNG
    robot.lcm.Publish(LINK.image_channel, message.encode())
    robot.simulator.AdvanceTo(0.04)
    assert robot.read("fault") == ""
    np.testing.assert_array_equal(robot.read("rgb").data, picture)


def test_commands_are_streamed_in_a_session_once_the_pusher_is_known():
    robot = Robot(armed=True)
    robot.simulator.AdvanceTo(0.05)
    robot.say(1.0)
    robot.simulator.AdvanceTo(0.1)
    robot.begin(77)
    robot.say(1.05)
    robot.simulator.AdvanceTo(0.15)
    robot.lcm.HandleSubscriptions(0)
    stamps = np.array([message.timestamp for message in robot.commands])
    assert (np.diff(stamps) == 5000).all()
    values = np.array([message.val for message in robot.commands])
    assert (values[stamps < 100_000, :4] == 0).all()
    assert (values[stamps > 110_000, :4] == [0.1, -0.05, 0.0, 77]).all()
    # Each has the number of its period, and ends a time-out after the last state, by the robot's clock.
    np.testing.assert_array_equal(values[:, 4], stamps / 5000)
    np.testing.assert_allclose(values[stamps > 110_000, 5], 1.05 + LINK.timeout)
    assert stamps[-1] >= 145_000


def test_a_session_that_the_robot_does_not_take_or_gives_up_is_a_fault():
    robot = Robot(armed=True)
    robot.begin(77)
    said = []
    for k in range(1, 60):
        t = 0.01 * k
        robot.say(1.0 + t, sequence=2 * k, mode=1 if 15 <= k < 40 else 0)
        robot.simulator.AdvanceTo(t)
        said.append(robot.read("fault"))
    assert said[5] == ""
    assert said[13].startswith("robot takes no commands of this session")
    assert said[20] == ""
    assert said[45].startswith("robot has closed the session")


def test_stopping_sends_zero_of_no_session_past_the_diagram():
    robot = Robot(armed=True)
    robot.station.engine.handle.SendStop(1.5)
    robot.lcm.HandleSubscriptions(0)
    assert [list(message.val) for message in robot.commands] == [[0.0] * 6]
    silent = Robot()
    silent.station.engine.handle.SendStop(1.5)
    silent.lcm.HandleSubscriptions(0)
    assert silent.commands == []


def test_a_driver_hears_zero_though_a_message_is_lost_that_comes_right_after_another():
    link = LcmLink(url="udpm://239.255.76.67:7671?ttl=0")
    driver, heard, over = make_lcm(link), list[bytes](), threading.Event()
    driver.Subscribe(link.command_channel, heard.append)

    def listen() -> None:
        while not over.is_set():
            driver.HandleSubscriptions(0)
            time.sleep(link.period)

    listener = threading.Thread(target=listen)
    listener.start()
    try:
        mine = make_lcm(link)
        for _ in range(5):
            mine.Publish(link.command_channel, signal_message(("vx",), np.ones(1), 0.0).encode())
        LcmHandle(mine, True, link.command_channel, link.period).SendStop(1.0)
        time.sleep(20 * link.period)
    finally:
        over.set()
        listener.join()
    values = [list(lcmt_drake_signal.decode(raw).val) for raw in heard]
    assert 2 <= len(values) < 7  # Drake's LCM drops some
    assert values[-1] == [0.0] * 6


def test_a_station_that_is_not_armed_sends_nothing():
    robot = Robot()
    robot.say(1.0)
    robot.simulator.AdvanceTo(0.1)
    robot.lcm.HandleSubscriptions(0)
    assert robot.commands == []
    assert not any("command_publisher" in system.get_name() for system in robot.station.GetSystems())


def test_meshcat_shows_the_pusher():
    meshcat = make_meshcat()
    station = make_station(setup_of(), "lcm", meshcat=meshcat)
    simulator = Simulator(station)
    station.GetInputPort("pusher_velocity_W").FixValue(simulator.get_mutable_context(), np.zeros(3))
    simulator.AdvanceTo(0.05)
    assert meshcat.HasPath("/station/scene/pusher")
    assert not meshcat.HasPath("/station/surfels/<object>")


def test_a_robot_is_not_put_into_place():
    robot = Robot()
    with pytest.raises(ParameterError, match="engine lcm: a program cannot move the object"):
        robot.station.SetPlace(robot.context, Place(REST, FAR))
    with pytest.raises(ParameterError, match="by hand"):
        robot.station.SetRandomContext(robot.context, RandomGenerator(0))


def test_a_scenario_names_the_channels(tmp_path):
    path = tmp_path / "robot.scenario.yaml"
    path.write_text("object: t_block\nlcm: {command_channel: LEFT, period: 0.01}\n")
    link = load_scenario(path).lcm
    assert (link.command_channel, link.period, link.url) == ("LEFT", 0.01, "memq://")
    path.write_text("object: t_block\nlcm: {timeout: 0}\n")
    with pytest.raises(InputError, match=r"lcm\.timeout.*0\.001 to 10"):
        load_scenario(path)


@pytest.fixture
def key(tmp_path):
    path = tmp_path / "robot.key"
    path.write_bytes(bytes(range(32)))
    path.chmod(0o600)
    return path


def test_with_a_key_forged_states_and_images_are_dropped_and_counted(key):
    robot, picture = Robot(key=key), np.zeros((80, 96, 4), np.uint8)
    picture[:40, :, 3] = 255
    forger = Robot()  # its messages are not signed
    forger.lcm = robot.lcm
    robot.say(1.0)
    robot.show(0.99, picture)
    robot.simulator.AdvanceTo(0.02)
    rgb = robot.read("rgb").data.copy()
    assert (rgb[:40] == [0, 0, 0, 255]).all()
    for k in range(1, 20):
        robot.say(1.0 + 0.01 * k)
        forger.say(0.5, 9 * STATE)
        forger.show(1.0, picture + 7)
        robot.lcm.Publish(LINK.state_channel, b"garbage")
        robot.simulator.AdvanceTo(0.02 + 0.01 * k)
        assert (robot.read("pusher_state") == STATE).all()
        assert (robot.read("rgb").data == rgb).all()
        assert robot.read("fault") == ""
    assert robot.tally.counts == {"not signed with the key": 3 * 19}


def test_with_a_key_commands_and_the_last_zero_are_signed(key):
    robot = Robot(armed=True, key=key)
    robot.say(1.0)
    robot.simulator.AdvanceTo(0.02)
    robot.begin(77)
    robot.simulator.AdvanceTo(0.05)
    robot.station.engine.handle.SendStop(0.05)
    robot.lcm.HandleSubscriptions(0)
    channel = LINK.command_channel
    checked = [robot.seal.verify(channel, raw) for raw in robot.raw]
    # The first was sent before it had heard of the driver.
    assert checked[0][1] == "of another run of the driver"
    assert {reason for _, reason in checked[3:]} == {""}
    values = [list(lcmt_drake_signal.decode(message).val) for message, _ in checked[3:]]
    assert values[-2][:4] == [0.1, -0.05, 0.0, 77.0]
    assert values[-1] == [0.0] * 6


def test_in_a_session_nobody_takes_the_place_of_the_driver(key):
    robot = Robot(armed=True, key=key)
    robot.say(1.0)
    robot.simulator.AdvanceTo(0.02)
    robot.begin(77)
    other = Robot(key=key)  # an earlier run of the driver, which somebody has recorded
    other.lcm, other.seal = robot.lcm, Seal(key.read_bytes(), bytes(range(16)))
    for k in range(1, 30):
        other.say(0.5 + 0.01 * k, 9 * STATE)
        robot.simulator.AdvanceTo(0.02 + 0.01 * k)
    assert robot.tally.counts == {"of another run of the driver": 29}
    assert np.isnan(robot.read("pusher_state")).all()
    robot.begin(0)
    other.say(0.9)
    robot.simulator.AdvanceTo(0.4)
    assert (robot.read("pusher_state") == STATE).all()


def test_an_exception_in_handling_is_a_fault_that_stays_in_a_session(monkeypatch):
    robot = Robot(armed=True)
    robot.say(1.0)
    robot.simulator.AdvanceTo(0.02)
    robot.begin(77)
    robot.simulator.AdvanceTo(0.03)

    def fail(*_):
        raise RuntimeError("on purpose")

    with monkeypatch.context() as patch:
        patch.setattr(receiver, "hear_state", fail)
        robot.say(1.03)
        robot.simulator.AdvanceTo(0.05)
    assert robot.read("fault") == "message cannot be handled: RuntimeError: on purpose"
    robot.say(1.05)
    robot.simulator.AdvanceTo(0.07)
    assert robot.read("fault").startswith("message cannot be handled")
    assert robot.tally.counts == {"cannot be handled": 1}


def test_bad_images_are_counted():
    robot = Robot()
    for k in range(3):
        robot.show(1.0 + k, np.zeros((8, 9, 4), np.uint8))
        robot.simulator.AdvanceTo(0.01 * (k + 1))
    words = "messages not used: 3 images that cannot be used; the last: PINWM_IMAGES, image has 9 by 8 px"
    assert robot.tally.line(0.0) == f"{words}; allowed: 96 by 80"


def test_a_place_beyond_a_kilometre_is_a_fault():
    robot = Robot()
    robot.say(1.0, [0.0, 1e308, 0.0, 0.0, 0.0, 0.0])
    robot.simulator.AdvanceTo(0.02)
    assert robot.read("fault") == "robot's state has 1e+308; allowed: 1000 m or m/s at most"
