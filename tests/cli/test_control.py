# SPDX-License-Identifier: MIT
import dataclasses
import io
import math
import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from pinwm_drake.cli import control
from pinwm_drake.control.pilot import ControlStatus
from pinwm_drake.learning.export import export_policy
from pinwm_drake.learning.policy import Policy
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.systems.control.loop import ControlRow
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.policy_scene import policy_spec
from pinwm_drake.systems.scenario.load import with_url
from tests.learning.bundles import exported, pictures, untrained_policy
from tests.systems.stations import action_setup
from tests.systems.view.test_meshcat import packed

pytestmark = pytest.mark.usefixtures("read_operators_once")

SIZE = 32


@pytest.fixture(scope="module")
def policy() -> Policy:
    setup = action_setup("push_t", image_size=SIZE)
    spec = policy_spec(setup, EnvOptions(frames=2, max_translation=0.02, max_steps=100), "rgb")
    return untrained_policy(spec)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory, policy) -> str:
    return str(exported(tmp_path_factory.mktemp("control") / "bundle", policy))


def places(output: str) -> list[tuple[float, float]]:
    """Of the pusher, mm, in every line."""
    return [(float(x), float(y)) for x, y in re.findall(r"pusher \((\S+), (\S+)\) mm", output)]


def test_a_dry_run_is_the_default(pinwm, bundle):
    code, output, errors = pinwm("control", bundle, "--engine", "twin", "--duration", "1")
    assert (code, errors) == (0, "")
    lines = output.splitlines()
    assert lines[0] == "twin, dry run: nothing moves (--arm does)"
    assert lines[1].startswith(
        "limits: 0.2 m/s, 4 m/s², images 0.2 s old, (-0.35, -0.35, 0.015) to (0.35, 0.35, 0.035)"
    )
    assert all("disarmed" in line for line in lines[2:-1])
    assert len(set(places(output))) == 1
    assert "action (" in lines[-2]
    assert lines[-1] == "dry run: nothing was moved"


def test_an_armed_one_moves_the_pusher(pinwm, bundle):
    code, output, _ = pinwm("control", bundle, "--engine", "twin", "--arm", "--duration", "1")
    assert code == 0
    assert output.startswith("twin, armed: the pusher moves")
    assert "running" in output
    assert len(set(places(output))) > 1
    assert "° from the goal" in output


def test_a_simulated_arm(pinwm, bundle):
    options = ("--simulate-arm", "--contact", "point", "--duration", "0.5")
    code, output, errors = pinwm("control", bundle, "--arm", *options)
    assert (code, errors) == (0, "")
    assert output.startswith("a simulated arm, armed: the pusher moves")
    moved = places(output)
    assert len(set(moved)) > 1
    code, output, _ = pinwm("control", bundle, *options)
    assert code == 0
    assert set(places(output)) == {moved[0]}


def test_a_simulated_panda(pinwm, bundle):
    options = ("--arm-model", "panda", "--contact", "point", "--duration", "0.3")
    code, output, errors = pinwm("control", bundle, "--arm", "--simulate-arm", *options)
    assert (code, errors) == (0, "")
    assert len(set(places(output))) > 1
    code, _, errors = pinwm("control", bundle, "--arm", *options)
    assert code == 1
    assert "--arm-model: got panda; allowed: iiwa, but with --simulate-arm" in " ".join(errors.split())
    code, _, errors = pinwm("control", bundle, "--arm", "--latency", "0.08")
    assert code == 1
    assert "--latency: got 0.08; allowed: 0, but with --simulate-arm" in " ".join(errors.split())


def robot_setup(key=None):
    return with_url(action_setup("push_t", image_size=SIZE), None, key)


def announced(setup, *, arm=None) -> str:
    written = io.StringIO()
    spec = policy_spec(setup, EnvOptions(frames=2, max_translation=0.02, max_steps=100), "rgb")
    control._announce(Console(file=written, width=300), True, arm, "lcm", setup, default_limits(spec))
    return written.getvalue()


def test_without_a_key_it_says_once_that_any_process_can_move_the_robot(tmp_path):
    words = "any process on this host can send commands to the robot"
    assert announced(robot_setup()).count(words) == 1
    assert words not in announced(robot_setup(), arm="panda")
    output = announced(robot_setup(tmp_path / "[a].key"))
    assert words not in output
    assert f"messages are signed with the key in {tmp_path}/[a].key\n" in output


def test_a_key_signs_between_controller_and_arm(pinwm, bundle, tmp_path):
    key = tmp_path / "robot.key"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    options = ("--arm", "--simulate-arm", "--contact", "point", "--duration", "0.5", "--key", str(key))
    code, output, errors = pinwm("control", bundle, *options)
    assert (code, errors) == (0, "")
    assert len(set(places(output))) > 1
    key.chmod(0o644)
    code, output, errors = pinwm("control", bundle, *options)
    assert (code, output) == (1, "")
    assert "robot.key: got mode 0644; allowed: 0600" in " ".join(errors.split())


def test_words_of_others_are_no_markup(policy):
    status = ControlStatus("latched", "image cannot be used: got unreadable PNG (chunk b'[/a]')", estimate="[red]x")
    row = ControlRow(0.0, status, np.full(2, np.nan), np.zeros(3), np.zeros(13), math.nan, math.nan, False)
    written = io.StringIO()
    Console(file=written, width=300).print(control._line(0.0, row, 0.0))
    assert "chunk b'[/a]'" in written.getvalue()
    assert "seen [red]x" in written.getvalue()


def test_a_fault_ends_it(pinwm, policy, tmp_path):
    away = dataclasses.replace(default_limits(policy.spec), box_low=(0.2, 0.2, 0.0), box_high=(0.3, 0.3, 0.1))
    export_policy(policy, tmp_path / "away", limits=away, samples=pictures(policy.spec))
    code, output, errors = pinwm("control", str(tmp_path / "away"), "--engine", "twin", "--arm")
    assert code == 1
    assert "latched" in output
    assert re.search(r"the pusher was stopped: pusher is \S+ mm outside of its box", errors)


def test_a_run_is_recorded_as_one_page_without_a_browser(pinwm, bundle, tmp_path):
    path = tmp_path / "new/run.html"
    options = ("--engine", "twin", "--arm", "--duration", "0.5", "--record", str(path))
    code, output, errors = pinwm("control", bundle, *options)
    assert (code, errors) == (0, "")
    assert f"wrote {path}\n" in output
    assert "Meshcat is at" not in output
    page = path.read_text()
    for name in (b"/station/goal", b"<object>/words/0", b"<object>/picture/0"):
        assert any(name in command for command in packed(page)), name


class Page:
    """As much of Meshcat as waits for a browser; somebody opens it after so many looks."""

    def __init__(self, looks: float):
        self.looks = looks

    def web_url(self):
        return "http://localhost:7000"

    def GetNumActiveConnections(self):
        self.looks -= 1
        return int(self.looks < 0)


@pytest.mark.parametrize(
    ("terminal", "looks", "said"), [(True, math.inf, True), (True, 2, False), (False, math.inf, False)]
)
def test_on_a_terminal_it_counts_down_until_somebody_opens_the_page(monkeypatch, terminal, looks, said):
    monkeypatch.setattr(control, "_PATIENCE", 0.3)
    written = io.StringIO()
    control._await_browser(Console(file=written, force_terminal=terminal, width=200), Page(looks))
    output = written.getvalue()
    assert output.startswith("Meshcat is at http://localhost:7000\n")
    assert ("waiting for a browser: the run begins in 1 s at the latest" in output) is terminal
    assert ("no browser opened the page within 0.3 s: the run begins" in output) is said


def test_the_arm_alone(pinwm):
    code, output, errors = pinwm(
        "arm", "--image-size", "16", "--contact", "point", "--duration", "0.2", "--lcm-url", "memq://"
    )
    assert (code, errors) == (0, "")
    assert output.startswith("a simulated arm listens at memq://")
    assert re.search(r"0\.2 s  tool \(.*\) mm, 0 mm/s  object", output)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--engine", "robot"], "--engine: got 'robot'; allowed: twin, hydroelastic, point, lcm"),
        (["--duration", "601"], "--duration: got 601.0; allowed: 0.1 to 600 s"),
        (["--contact", "soft"], "--contact: got 'soft'; allowed: hydroelastic, point"),
        (["--seed", "-1"], "--seed: got -1; allowed: 0 to"),
        (["--engine", "twin", "--lcm-url", "memq://"], "--lcm-url: got memq://; allowed: none, but for a robot"),
        (["--engine", "lcm", "--lcm-url", "udpm://239.255.76.67:7667?ttl=1"], "?ttl=0"),
        (["--engine", "lcm", "--meshcat"], "--meshcat: got True; allowed: none for a robot"),
        (["--engine", "lcm", "--record", "a.html"], "--record: got a.html; allowed: none for a robot"),
        (["--engine", "twin", "--key", "a.key"], "--key: got a.key; allowed: none, but with lcm"),
        (["--record", "a.mp4"], "--record: got a.mp4; allowed: a name that ends in .html or .htm"),
    ],
)
def test_what_is_refused(pinwm, bundle, options, message):
    code, output, errors = pinwm("control", bundle, *options)
    assert (code, output) == (1, "")
    assert message in errors


def test_a_folder_that_is_no_bundle(pinwm, tmp_path):
    code, _, errors = pinwm("control", str(tmp_path))
    assert code == 1
    assert str(Path(tmp_path)) in errors
