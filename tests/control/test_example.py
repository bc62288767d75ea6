# SPDX-License-Identifier: MIT
"""The example of docs/how-to/run-a-bundle.md, with the twin's station as somebody's robot."""

import dataclasses
import re
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator

from pinwm_drake.learning.bundle import read_bundle
from pinwm_drake.systems.envs.policy_scene import check_scene
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.schema import View
from pinwm_drake.systems.scenario.setup import make_setup
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.systems.station.station import make_station

PAGE = Path(__file__).resolve().parents[2] / "docs/how-to/run-a-bundle.md"


class Robot:
    """A station in the place of a robot: images 20 times a second, 40 ms late, with a camera's noise."""

    def __init__(self, seed):
        scenario = load_setup("push_t").scenario
        setup = make_setup(dataclasses.replace(scenario, camera=View(width=64, height=64)))
        check_scene(read_bundle("push_t").spec, setup)
        self.station = make_station(setup, "twin")
        self.simulator = Simulator(self.station)
        self.context = self.simulator.get_mutable_context()
        self.generator = np.random.default_rng(seed)
        self.station.SetPlace(self.context, StartDistribution(setup).draw(self.generator))
        self.move(np.zeros(3))
        self.waiting, self.moved = [], 0.0

    def read(self, name):
        return self.station.GetOutputPort(name).Eval(self.context)

    def time(self):
        return self.context.get_time()

    def pusher(self):
        return self.read("pusher_state")[:3]

    def image(self):
        if round(100 * self.time()) % 5 == 0:
            rgba = self.read("rgb").data.copy()
            seen = rgba[..., 3] > 0
            noise = self.generator.normal(0.0, 1.0, rgba.shape)
            rgba[seen, :3] = np.clip(rgba + noise, 0, 254).astype(np.uint8)[seen, :3]
            self.waiting.append((self.time(), rgba))
        due = self.waiting and self.time() - self.waiting[0][0] > 0.035
        return self.waiting.pop(0) if due else None

    def move(self, velocity):
        self.velocity = np.array(velocity)
        self.station.GetInputPort("pusher_velocity_W").FixValue(self.context, self.velocity)

    def wait(self, seconds):
        self.moved += seconds * np.linalg.norm(self.velocity)
        self.simulator.AdvanceTo(round(100 * (self.time() + seconds)) / 100)


def test_it_brings_the_object_to_the_goal():
    code = re.search(r"```python\n(import numpy.*?)```", PAGE.read_text(), re.DOTALL)[1]
    assert len(code.strip().splitlines()) <= 30
    names = {}
    exec(code, names)
    robot = Robot(3)
    reason = names["control"](robot)
    assert reason == "at the goal, by the policy's estimate"
    assert robot.moved > 0.1  # m
    np.testing.assert_array_equal(robot.velocity, np.zeros(3))
    state = robot.read("object_state")
    assert np.hypot(*state[4:6]) < 0.03
