# SPDX-License-Identifier: MIT
"""The simulated arm behind LCM: it follows commands, stops without them, and a controller pushes with it."""

import dataclasses

import numpy as np
import pytest
from drake import lcmt_panda_command, lcmt_panda_status
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from pinwm_drake.errors import ParameterError, StateError
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.systems.arm.driver import ArmDriver, arm_limits
from pinwm_drake.systems.arm.gate import FAST_JOINT, TOO_FAST
from pinwm_drake.systems.arm.messages import PANDA_COMMAND, PANDA_STATUS
from pinwm_drake.systems.arm.model import ARMS
from pinwm_drake.systems.control.loop import ControlLoop
from pinwm_drake.systems.engines.lcm.link import make_lcm
from pinwm_drake.systems.engines.lcm.signal import COMMAND_NAMES, signal_message
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.policy_scene import policy_spec
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place
from tests.systems.stations import action_setup

HEIGHT, SPEED = 0.025, 0.15
PLACE = Place(RigidTransform([0.0, 0.05, HEIGHT]), np.array([0.01, -0.12, HEIGHT]))
GOAL = np.array([0.0, 0.03])  # m, of the pusher: 30 mm into where the object is


@pytest.fixture(scope="module")
def setup() -> Setup:
    # With so much friction the object stops at once.
    return action_setup("push_t", image_size=32).with_theta(friction_floor=0.3)


class Towards:
    """Stands for a bundle: goes to `GOAL`, slower near it; counts what it sees of the object."""

    def __init__(self, setup):
        self.spec = policy_spec(setup, EnvOptions(frames=2, max_translation=0.02, max_steps=50), "rgb")
        self.seen = []

    def act(self, image, p_WP):
        self.seen.append(int((image[..., 3:].min(axis=2) < 250).sum()))
        d = 0.4 * (GOAL - p_WP)
        return d * min(1.0, 0.02 / max(np.linalg.norm(d), 1e-9))


class Track:
    """A driver alone, to which commands are given by hand, and what its tool does."""

    def __init__(self, setup, arm="iiwa", place=PLACE.p_WP):
        self.lcm = make_lcm(setup.scenario.lcm)
        builder = DiagramBuilder()
        self.driver = builder.AddSystem(ArmDriver(without_images(setup), self.lcm, arm=arm, contact="point"))
        names = ("pusher_state", "tool_target", "arm_state")
        self.logs = {name: LogVectorOutput(self.driver.GetOutputPort(name), builder, 0.005) for name in names}
        self.simulator = Simulator(builder.Build())
        self.driver.SetPlace(self.simulator.get_mutable_context(), Place(RigidTransform([0, 0.2, HEIGHT]), place))
        self.simulator.Initialize()
        self.step = 0

    def go(self, seconds, velocity=None, sequence=None, session=7):
        """Simulates, with a command each 10 ms if there is one."""
        for _ in range(round(seconds / 0.01)):
            if velocity is not None:
                number, expiry = self.step if sequence is None else sequence, 0.01 * self.step + 0.1
                values = np.array([*velocity, session, number, expiry])
                message = signal_message(COMMAND_NAMES, values, 0.01 * self.step)
                self.lcm.Publish("PINWM_PUSHER_COMMAND", message.encode())
            self.step += 1
            self.simulator.AdvanceTo(0.01 * self.step)

    def log(self, name):
        return self.logs[name].FindLog(self.simulator.get_context()).data().T

    @property
    def speed(self):
        return np.linalg.norm(self.log("pusher_state")[-1, 3:])


def without_images(setup: Setup) -> Setup:
    link = dataclasses.replace(setup.scenario.lcm, image_period=10.0)
    return dataclasses.replace(setup, scenario=dataclasses.replace(setup.scenario, lcm=link))


def run(setup, engine, *, armed=True, seconds=2.2, **options):
    """The loop after a run, its rows, and the policy."""
    policy = Towards(setup)
    loop = ControlLoop(policy, default_limits(policy.spec), setup, engine, armed=armed, **options)
    loop.begin(PLACE)
    loop.listen()
    rows = list(loop.advance(seconds))
    return loop, rows, policy


def test_the_same_controller_pushes_in_the_twin_and_with_the_arm(setup):
    _, twin, _ = run(setup, "twin")
    loop, arm, policy = run(setup, "lcm", simulate_arm=True)
    assert {row.status.state for row in arm[1:]} == {"running"}
    ends = [rows[-1].object_state[4:7] for rows in (twin, arm)]
    assert ends[0][1] > 0.07  # of 0.05 at first
    # The arm is late by a tenth of a second, and goes a little beyond where it is to stop.
    assert np.abs(ends[0] - ends[1]).max() < 0.004
    assert np.abs(arm[-1].p_WP[:2] - GOAL).max() < 0.003
    heights = [row.p_WP[2] for row in arm]
    assert np.abs(np.array(heights) - HEIGHT).max() < 5e-4
    assert min(policy.seen) > 20  # px: the arm does not hide the object
    # Images are those of the present, but for the way.
    assert max(row.status.image_age for row in arm[2:]) < 0.06
    loop.stop()
    assert loop.row().status.state == "disarmed"
    with pytest.raises(StateError, match="this loop has run over LCM before"):
        loop.begin(PLACE)


def test_a_dry_run_moves_nothing(setup):
    _, rows, policy = run(setup, "lcm", armed=False, simulate_arm=True, contact="point", seconds=0.6)
    assert {row.status.state for row in rows} == {"disarmed"}
    # It tells what it would do.
    towards = GOAL - PLACE.p_WP[:2]
    assert np.allclose(rows[-1].raw_action, 0.02 * towards / np.linalg.norm(towards), atol=1e-5)
    assert len(policy.seen) >= 5
    assert np.abs(rows[-1].p_WP - PLACE.p_WP).max() < 1e-5
    assert np.abs(rows[-1].object_state[4:6] - PLACE.X_WO.translation()[:2]).max() < 1e-5
    _, rows, _ = run(setup, "twin", armed=False, seconds=0.6)
    assert (rows[-1].p_WP == PLACE.p_WP).all()


def test_images_of_a_late_camera_are_as_old_as_that(setup):
    _, rows, _ = run(setup, "lcm", simulate_arm=True, contact="point", seconds=0.6, latency=0.08)
    ages = [row.status.image_age for row in rows[2:]]
    assert {row.status.state for row in rows[1:]} == {"running"}
    assert min(ages) >= 0.08 - 1e-6
    assert max(ages) < 0.08 + 0.06


@pytest.mark.parametrize("arm", ARMS)
def test_the_tool_follows_within_millimetres_at_its_height(setup, arm):
    track = Track(setup, arm)
    track.go(0.5, [0.0, SPEED, 0.0])
    for angle in np.linspace(0.0, 2 * np.pi, 60):
        track.go(0.01, [SPEED * np.sin(angle), SPEED * np.cos(angle), 0.1])
    tool, target = track.log("pusher_state"), track.log("tool_target")
    assert np.linalg.norm(target[-1, :2] - PLACE.p_WP[:2]) > 0.06
    # Late by some 7 ms, so by 1 mm; from the path itself, half of that.
    assert np.linalg.norm(tool[:, :2] - target[:, :2], axis=1).max() < 0.002
    gaps = np.linalg.norm(tool[:, None, :2] - target[None, :, :2], axis=2).min(axis=1)
    assert gaps.max() < 0.001
    assert np.abs(tool[:, 2] - HEIGHT).max() < 5e-4
    # The rod points down, or nearly, where it may swing.
    rotation = track.driver.tool_pose(track.simulator.get_context()).rotation().matrix()
    assert np.degrees(np.arccos(rotation[2, 2])) < (3.0 if ARMS[arm].swings else 0.2)


@pytest.mark.parametrize("arm", ARMS)
def test_the_tool_goes_up_where_the_task_moves_it_up(arm):
    track = Track(action_setup("flip_cube", image_size=32), arm)
    begin = track.log("pusher_state")[-1, :3] if len(track.log("pusher_state")) else PLACE.p_WP
    track.go(0.4, [0.05, 0.0, 0.15])
    end = track.log("pusher_state")[-1, :3]
    np.testing.assert_allclose(end - begin, [0.02, 0.0, 0.06], atol=6e-3)
    limits = track.driver.limits
    assert (limits.box_low[2], limits.box_high[2]) == (0.014, 0.3)


@pytest.mark.parametrize(
    ("how", "arm"),
    [
        *((how, "iiwa") for how in ("nothing", "one that is repeated", "no number")),
        ("nothing", "panda"),
        *(pytest.param(how, "panda", marks=pytest.mark.nightly) for how in ("one that is repeated", "no number")),
    ],
)
def test_the_arm_stops_when_commands_stop(setup, how, arm):
    track = Track(setup, arm)
    track.go(0.3, [0.0, SPEED, 0.0])
    assert abs(track.speed - SPEED) < 0.02
    last = track.step - 1
    silence = {"nothing": {}, "one that is repeated": {"velocity": [0.0, SPEED, 0.0], "sequence": last},
               "no number": {"velocity": [np.nan, SPEED, 0.0]}}[how]  # fmt: skip
    before = track.log("pusher_state")[-1, 1]
    track.go(0.3, **silence)
    assert track.speed < 1e-3
    after = track.log("pusher_state")[-1, 1]
    # The time-out, and v^2 / 2 a.
    longest = (0.12 if how != "no number" else 0.02) * SPEED + SPEED**2 / (2 * track.driver.limits.max_acceleration)
    assert after - before < longest + 0.002
    # The session is over; another one moves it again.
    track.go(0.2, [0.0, SPEED, 0.0])
    assert track.speed < 1e-3
    track.go(0.2, [0.0, SPEED, 0.0], session=8)
    assert abs(track.speed - SPEED) < 0.02


@pytest.mark.parametrize("arm", ARMS)
def test_speed_and_box_are_the_arms_own(setup, arm):
    track = Track(setup, arm)
    limits = arm_limits(setup, arm)
    track.go(0.2, [-limits.max_speed, 0.0, 0.0])
    track.go(0.2, [-5.0, 0.0, 0.0])
    assert track.speed < 1e-3
    assert track.driver.GetSubsystemByName("command_gate").gate(track.simulator.get_context()).fault == TOO_FAST
    track.go(1.2, [-limits.max_speed, 0.0, 0.0], session=8)
    assert limits.max_speed == setup.scenario.pusher.max_speed
    tool, target = track.log("pusher_state"), track.log("tool_target")
    assert abs(np.abs(target[:, 3]).max() - limits.max_speed) < 1e-9
    # The servo makes up for its lag; needed: 12 %.
    assert np.abs(tool[:, 3]).max() < 1.2 * limits.max_speed
    assert abs(tool[-1, 0] - limits.box_low[0]) < 1e-3
    assert track.speed < 1e-3


def test_a_panda_keeps_the_limits_of_its_joints_whatever_is_commanded():
    track = Track(action_setup("flip_mug", image_size=32), "panda", np.array([-0.1, 0.0, 0.1]))
    heard = {name: [] for name in (PANDA_COMMAND, PANDA_STATUS)}
    for name, messages in heard.items():
        track.lcm.Subscribe(name, messages.append)
    limits, generator = track.driver.limits, np.random.default_rng(0)
    assert (limits.max_speed, limits.max_acceleration) == (1.25, 7.0)
    middle = 0.5 * (np.array(limits.box_low) + limits.box_high)
    for _ in range(16):
        way = generator.normal(size=3) + 5.0 * (middle - track.log("tool_target")[-1, :3] if track.step else 0.0)
        track.go(0.1, 1.25 * way / np.linalg.norm(way))
    plant, joints = track.driver.model.plant, track.log("arm_state")
    low, high = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    assert ((low < joints[:, :7]) & (joints[:, :7] < high)).all()
    assert (np.abs(joints[:, 7:]) < plant.GetVelocityUpperLimits()).all()
    # The fastest is near its limit, and the rod swings.
    assert (np.abs(joints[:, 7:]) / plant.GetVelocityUpperLimits()).max() > 0.9
    off = np.linalg.norm(track.log("pusher_state")[:, :3] - track.log("tool_target")[:, :3], axis=1)
    assert np.median(off) < 0.01
    # What a driver of Drake's would hear, and say.
    track.lcm.HandleSubscriptions(0)
    command = lcmt_panda_command.decode(heard[PANDA_COMMAND][-1])
    status = lcmt_panda_status.decode(heard[PANDA_STATUS][-1])
    assert (command.num_joint_position, command.num_joint_velocity, command.num_joint_torque) == (7, 7, 0)
    np.testing.assert_allclose(status.joint_position, joints[-1, :7], atol=0.1)
    assert np.abs(status.joint_torque).max() > 0.1


def test_a_panda_whose_joint_is_pushed_too_fast_stops_and_latches():
    track = Track(action_setup("flip_mug", image_size=32), "panda", np.array([-0.1, 0.0, 0.1]))
    track.go(0.1, [0.1, 0.0, 0.0])
    gate, context = track.driver.GetSubsystemByName("command_gate"), track.simulator.get_mutable_context()
    assert gate.gate(context).fault == 0
    plant, arm = track.driver._parts.plant, track.driver._arm
    mine = plant.GetMyMutableContextFromRoot(context)
    v = np.zeros(7)
    v[4] = 1.05 * track.driver.model.plant.GetVelocityUpperLimits()[4]
    plant.SetVelocities(mine, arm, v)
    track.go(0.3, [0.1, 0.0, 0.0])
    assert gate.gate(context).fault == FAST_JOINT
    assert track.speed < 1e-3


@pytest.mark.parametrize(("scene", "step"), [("push_t", 0.0025), ("flip_mug", 0.00125)])
def test_an_arm_that_lifts_has_shorter_steps(scene, step):
    track = Track(action_setup(scene, image_size=32))
    assert track.driver._parts.plant.time_step() == step


def test_a_panda_carries_a_fast_poke():
    track = Track(action_setup("flip_mug", image_size=32), "panda", np.array([-0.2, 0.0, 0.1]))
    track.go(0.25, [1.1, 0.0, 0.5])
    tool, target = track.log("pusher_state"), track.log("tool_target")
    assert abs(np.linalg.norm(target[-1, 3:]) - np.hypot(1.1, 0.5)) < 1e-9
    # The target that is logged is 5 ms older.
    now = target[:, :3] + 0.005 * target[:, 3:]
    assert np.linalg.norm(tool[:, :3] - now, axis=1).max() < 0.003
    # It stops within 0.2 s, and stays.
    track.go(0.35, [0.0, 0.0, 0.0])
    assert track.speed < 1e-3


def test_what_cannot_be(setup):
    policy = Towards(setup)
    limits = default_limits(policy.spec)
    with pytest.raises(ParameterError, match="got 'twin' with a simulated arm; allowed: lcm"):
        ControlLoop(policy, limits, setup, "twin", simulate_arm=True)
    far = dataclasses.replace(setup.scenario.start, x=[3.0, 3.0])
    away = dataclasses.replace(setup, scenario=dataclasses.replace(setup.scenario, start=far))
    loop = ControlLoop(policy, limits, away, "lcm", simulate_arm=True, contact="point")
    with pytest.raises(ParameterError, match="allowed: the arm's reach"):
        loop.draw_place(np.random.default_rng(0))
    with pytest.raises(ParameterError, match="out of the arm's reach"):
        loop.begin(Place(PLACE.X_WO, np.array([0.5, 0.0, HEIGHT])))


def test_a_robot_that_says_nothing(setup):
    loop = ControlLoop(policy := Towards(setup), default_limits(policy.spec), setup, "lcm", armed=True)
    loop.simulator.set_target_realtime_rate(0.0)
    loop.begin(PLACE)
    with pytest.raises(StateError, match="lcm: no image and no state of the pusher from memq://"):
        loop.listen(patience=0.3)
