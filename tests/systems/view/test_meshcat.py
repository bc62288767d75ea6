# SPDX-License-Identifier: MIT
import base64
import logging
import re
import socket
from pathlib import Path

import numpy as np
import pytest
import umsgpack
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.systems.view.meshcat import AddThetaSliders, ReadThetaSliders, make_meshcat, recorded
from tests.systems.shown import X_WO, small_setup, station


@pytest.fixture(scope="module")
def meshcat():
    return make_meshcat()


@pytest.fixture(scope="module")
def setup():
    return small_setup()


def addresses(port: int) -> set[str]:
    """Where some process listens on a port, in the kernel's byte order."""
    found = set()
    for table in ("tcp", "tcp6"):
        path = Path(f"/proc/self/net/{table}")
        for line in path.read_text().splitlines()[1:] if path.exists() else ():
            fields = line.split()
            address, number = fields[1].split(":")
            if fields[3] == "0A" and int(number, 16) == port:
                found.add(address)
    return found


def packed(html: str) -> list[bytes]:
    """The commands that a page of Meshcat's carries, without the assets that these name."""
    html = re.sub(r"casAssets\[.*", "", html)
    return [base64.b64decode(text) for text in re.findall(r"octet-binary;base64,([A-Za-z0-9+/=]+)", html)]


def messages(html: str) -> list[dict]:
    """The same, unpacked."""
    return [umsgpack.unpackb(message) for message in packed(html)]


@pytest.mark.skipif(not Path("/proc/self/net/tcp").exists(), reason="needs Linux's table of sockets")
def test_the_server_listens_on_this_machine_only(meshcat):
    assert meshcat.web_url() == f"http://localhost:{meshcat.port()}"
    # 127.0.0.1, or ::1.
    assert addresses(meshcat.port()) <= {"0100007F", "00000000000000000000000001000000"}
    assert addresses(meshcat.port())
    everywhere = make_meshcat(host="*")
    assert addresses(everywhere.port()) & {"00000000", "0" * 32}


def test_the_server_starts_silently_and_leaves_drakes_logging_as_it_was(caplog, capfd):
    with caplog.at_level(logging.INFO, logger="drake"):
        made = make_meshcat()
        assert made.web_url().startswith("http://localhost:")
        assert (caplog.messages, capfd.readouterr()) == ([], ("", ""))
        assert logging.getLogger("drake").level == logging.INFO
        Meshcat()  # Drake's own is heard
        assert "listening" in caplog.text


def test_a_port_that_is_taken_or_out_of_range_is_refused():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ParameterError, match=rf"host, port: got localhost, {port} .*; allowed: an address"):
            make_meshcat(port=port)
    with pytest.raises(ParameterError, match=r"host, port: got localhost, 80; allowed: .* 1024 or more"):
        make_meshcat(port=80)


def test_sliders_hand_back_what_they_were_set_to(meshcat):
    assert ReadThetaSliders(meshcat) == {}
    theta = {"mass": 1.25, "friction_floor": 0.031, "friction_pusher": 0.5, "restitution": 0.1}
    AddThetaSliders(meshcat, theta)
    assert ReadThetaSliders(meshcat) == pytest.approx(theta, abs=1e-12)
    meshcat.SetSliderValue("friction, floor", 0.2)
    assert ReadThetaSliders(meshcat)["friction_floor"] == pytest.approx(0.2)
    # A second call sets them again.
    AddThetaSliders(meshcat, {"friction_floor": 0.05, "mass": 2.0})
    assert ReadThetaSliders(meshcat) == pytest.approx({**theta, "friction_floor": 0.05, "mass": 2.0})
    with pytest.raises(ParameterError, match="theta: got 'friction'; allowed: mass, friction_floor"):
        AddThetaSliders(meshcat, {"friction": 0.1})


def test_a_simulation_is_recorded_in_one_file(meshcat, setup, tmp_path):
    diagram = station(meshcat, setup)
    path = tmp_path / "a.html"
    with recorded(meshcat, path):
        Simulator(diagram).AdvanceTo(0.5)
    (animation,) = (message for message in messages(path.read_text()) if message["type"] == "set_animation")
    tracks = {entry["path"]: entry["clip"] for entry in animation["animations"]}
    assert {"/station/surfels", "/station/scene/box/object", "/station/forces/floor/0"} <= set(tracks)
    (position,) = (track for track in tracks["/station/surfels"]["tracks"] if track["name"] == ".position")
    # 30 frames a second from 0 to 0.5 s.
    assert [key["time"] for key in position["keys"]] == list(range(16))
    np.testing.assert_allclose(position["keys"][-1]["value"], X_WO.translation())
    # A second recording does not hold the first.
    with recorded(meshcat, path):
        Simulator(diagram).AdvanceTo(0.1)
    (animation,) = (message for message in messages(path.read_text()) if message["type"] == "set_animation")
    assert (
        max(key["time"] for entry in animation["animations"] for t in entry["clip"]["tracks"] for key in t["keys"]) == 3
    )
    assert meshcat.StaticHtml() == path.read_text()
    assert [file.name for file in tmp_path.iterdir()] == ["a.html"]


def test_a_recording_that_fails_leaves_the_file_as_it_was(meshcat, tmp_path):
    path = tmp_path / "a.html"
    path.write_text("before")
    with pytest.raises(ZeroDivisionError), recorded(meshcat, path):
        raise ZeroDivisionError
    assert path.read_text() == "before"
    with pytest.raises(InputError, match="got a folder; allowed: a file"), recorded(meshcat, tmp_path):
        pass
