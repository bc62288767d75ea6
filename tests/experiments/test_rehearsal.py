# SPDX-License-Identifier: MIT
"""The rehearsal: what its faults do to messages, the relay, and trials on disk. The whole is run once."""

import json
import os
import re
import socket
import time
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from drake import lcmt_drake_signal, lcmt_image_array

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.experiments.rehearsal.faults import KINDS, kind_of
from pinwm_drake.experiments.rehearsal.processes import Relay, robot_link
from pinwm_drake.experiments.rehearsal.report import write_rehearsal_report
from pinwm_drake.experiments.rehearsal.run import RESULTS_FILE, TRIALS_FILE, Trial, _share, rehearse, summary
from pinwm_drake.experiments.requests.control import RehearseRequest
from pinwm_drake.systems.arm.messages import image_message
from pinwm_drake.systems.engines.lcm.link import make_lcm
from pinwm_drake.systems.engines.lcm.receiver import pixels_of
from pinwm_drake.systems.engines.lcm.signal import COMMAND_NAMES, signal_message
from pinwm_drake.systems.scenario.schema import LcmLink

GOOD = Trial("white images", 0, 0.5, "latched", "mask: none", 0.02, 0.15, True, True, False, 4, 0.6)


def picture(column=20):
    """An image message with an object of 100 px from a column on, and its pixels."""
    pixels = np.full((64, 64, 4), 255, np.uint8)
    pixels[..., 3] = 0
    pixels[30:40, column : column + 10] = np.arange(400, dtype=np.uint8).reshape(10, 10, 4)
    pixels[30:40, column : column + 10, 3] = 255
    return image_message(pixels, 12.5).encode(), pixels


def disturbed(name, message, past=()):
    """The messages that a fault passes on in the place of one, and their delays."""
    passed = kind_of(name).make([*past, message])(message)
    return [one for _, one in passed], [delay for delay, _ in passed]


def shown(message):
    """Stamp [us] and pixels."""
    array = lcmt_image_array.decode(message)
    return array.header.utime, pixels_of(array.images[0])


@pytest.mark.parametrize(
    ("name", "object_pixels"), [("white images", 0), ("lost mask", 2), ("mask of all", 4096), ("jumping mask", 100)]
)
def test_faults_of_the_mask_keep_stamp_and_size(name, object_pixels):
    message, pixels = picture()
    (passed,), delays = disturbed(name, message)
    stamp, found = shown(passed)
    assert (stamp, found.shape, delays) == (12_500_000, (64, 64, 4), [0.0])
    assert (found[..., 3] > 0).sum() == object_pixels
    assert (found != pixels).any()


def test_a_frozen_image_has_the_next_ones_stamp():
    old, pixels = picture()
    frozen = kind_of("frozen images").make([old])
    new = image_message(picture(40)[1], 13.0).encode()
    stamp, found = shown(frozen(new)[0][1])
    assert stamp == 13_000_000
    np.testing.assert_array_equal(found, pixels)


def test_images_of_another_kind_or_torn_cannot_be_read():
    message, _ = picture()
    for name in ("grey images", "torn images"):
        with pytest.raises(ValueError, match=r"allowed|unreadable"):
            shown(disturbed(name, message)[0][0])
    assert shown(disturbed("small images", message)[0][0])[1].shape == (32, 32, 4)
    assert shown(disturbed("images of the past", message)[0][0])[0] == 11_500_000


def test_faults_of_commands():
    def command(sequence, session=7.0):
        return signal_message(COMMAND_NAMES, np.array([0.1, -0.2, 0.0, session, sequence, 9.0]), 1.0).encode()

    def values(messages):
        return [list(lcmt_drake_signal.decode(message).val) for message in messages]

    mine, foreign = values(disturbed("second controller", command(3))[0])
    assert mine[3] == 7.0
    assert foreign[3] not in (0.0, 7.0)
    assert foreign[:2] == [-0.1, 0.2]
    past = [command(0, session=5.0), command(1), command(2)]
    assert [one[4] for one in values(disturbed("replayed commands", command(3), past)[0])] == [3.0, 1.0]
    assert values(disturbed("expired commands", command(3))[0])[0][5] == 0.0
    assert len(values(disturbed("commands of no session", command(3))[0])[0]) == 3
    assert disturbed("no commands", command(3))[0] == []
    assert disturbed("queue of commands", command(3))[1] == [5.0]


def test_the_relay_passes_messages_on_until_a_fault_begins():
    link = LcmLink(url="udpm://239.255.76.67:7673?ttl=0")
    relay, controller, robot = Relay(link, os.getpid()), make_lcm(link), make_lcm(link)
    heard = []
    robot.Subscribe(robot_link(link).command_channel, heard.append)

    def say(velocity):
        controller.Publish(
            link.command_channel, signal_message(COMMAND_NAMES, np.array([velocity, 0, 0, 1, 1, 1]), 0.0).encode()
        )
        end = time.monotonic() + 0.1
        while time.monotonic() < end:
            relay.spin()
            robot.HandleSubscriptions(1)
        return len(heard)

    assert say(0.1) == 1
    moved = relay.traffic.moved
    relay.begin("no commands")
    assert say(0.0) == 1
    assert relay.traffic.moved == moved < relay.traffic.begun
    assert relay.traffic.last[0] == 0.0
    relay.clear()
    assert say(0.1) == 2


@pytest.mark.parametrize(
    "change",
    [{"after": None}, {"state": "running"}, {"to_zero": 0.2}, {"zero": False}, {"at_rest": False}],
    ids=lambda change: next(iter(change)),
)
def test_a_fault_is_stopped_in_time_with_zero_on_the_wire_or_not_good(change):
    assert GOOD.good
    assert not replace(GOOD, **change).good


def test_normal_work_is_good_unless_it_was_stopped():
    normal = replace(GOOD, kind="", after=None, state="done", success=True)
    assert normal.good
    assert not replace(normal, state="latched").good
    found = summary([normal, replace(normal, state="latched", success=False), GOOD])
    assert (found["normal"]["episodes"], found["normal"]["false_stops"], found["normal"]["successes"]) == (2, 1, 1)
    assert found["faults"]["white images"]["good"] == 1


@pytest.mark.parametrize(
    ("values", "message"),
    [({"moments": -1}, "--moments"), ({"kinds": ("fire",)}, "--kind"), ({"latency": 2.0}, "--latency")],
)
def test_requests_out_of_range(values, message):
    with pytest.raises(ParameterError, match=message):
        RehearseRequest("push_t", **values)


@pytest.mark.parametrize(
    ("options", "faults", "kinds", "expected"),
    [
        ({"faults": True}, 4, ["a", "a"], 0.5),
        ({"episodes": 4}, 0, ["", "", ""], 0.75),
        ({"faults": True, "episodes": 4}, 4, ["a", "a", "a", "a", "", ""], 0.75),
        ({"minutes": 1.0}, 0, ["", ""], 1.0 / 3.0),
        ({"minutes": 1.0}, 0, [""] * 9, 1.0),
    ],
)
def test_the_share_that_is_done_counts_trials_and_minutes(options, faults, kinds, expected):
    request = RehearseRequest("push_t", **options)
    trials = [SimpleNamespace(kind=kind, duration=10.0) for kind in kinds]
    assert _share(request, faults, trials) == pytest.approx(expected)


@pytest.mark.nightly
def test_a_rehearsal_goes_on_where_it_was_cut_off(tmp_path):
    request = RehearseRequest("push_t", faults=True, moments=2, kinds=("white images",), port=7674)

    def go_on(changed=request, resume=True):
        seen = []
        trials = rehearse(changed, tmp_path, resume=resume, report=lambda *args: seen.append(args[2]))
        return trials, seen

    trials, seen = go_on(resume=False)
    assert [(one.kind, one.seed) for one in trials] == [("white images", 0), ("white images", 1)]
    for one in trials:
        assert (one.state, one.zero, one.at_rest) == ("latched", True, True)
    assert trials == seen
    path = tmp_path / TRIALS_FILE
    first, second = path.read_text().splitlines()
    assert json.loads(first) == asdict(trials[0])
    assert json.loads((tmp_path / RESULTS_FILE).read_text())["summary"]["faults"]["white images"]["trials"] == 2
    write_rehearsal_report(tmp_path / "report.html", request, trials)
    assert "white images" in (tmp_path / "report.html").read_text()

    with pytest.raises(InputError, match="allowed: a new folder, or --resume"):
        go_on(resume=False)
    with pytest.raises(InputError, match=re.escape("latency 0.08; allowed: 0.0, as it was begun with")):
        go_on(replace(request, latency=0.08))
    path.write_text(first + "\n" + second[:40])  # as after kill -9
    trials, seen = go_on(replace(request, moments=1))
    assert (len(trials), seen) == (1, [])
    assert path.read_text() == first + "\n"
    path.write_text(first + "\n{}\n" + second + "\n")
    with pytest.raises(InputError, match=r"row 2: got \{\}"):
        go_on()


def test_a_port_that_is_taken_is_refused(tmp_path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        with pytest.raises(ParameterError, match=f"--port: got {port}, which is in use"):
            rehearse(RehearseRequest("push_t", episodes=1, port=port), tmp_path, report=lambda *_: None)


def test_each_kind_has_a_name_of_its_own():
    assert len({kind.name for kind in KINDS}) == len(KINDS) >= 20
