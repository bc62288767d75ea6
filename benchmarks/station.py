# SPDX-License-Identifier: MIT
"""Cost of the station beyond the bare step and render: one action of 0.1 s and one 64 x 64 image, 1 and 32 worlds.

The bare loop calls `Stepper.rollout`, the batched API, as often as the diagram updates its state, and `render` once.
The unchecked one calls `Stepper.roll` instead, as the station does: plain arrays, nothing looked at. The station
does it inside Drake's Simulator, with limits on the pusher, and makes the image what a policy sees: 8 bits, masked,
hidden where the pusher stands before.
"""

import argparse

from benchmarks import results, timing

if __name__ == "__main__":
    timing.limit_threads(2)  # before numba and torch are imported

import numpy as np
import torch
from pydrake.systems.analysis import Simulator

from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.rendering.render import render
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.systems.scenario.schema import Physics, Scenario, Start, Theta, View
from pinwm_drake.systems.scenario.setup import make_setup
from pinwm_drake.systems.station.station import SceneStation, make_station

BARS = {1: 0.30, 32: 0.05}
STEPS = 24  # of 1 / 240 s, an action
WARM_UP = 0.25  # s, after which the pusher is in touch with the block
SPEED = 0.3  # m/s


class Action:
    """Action in a station, and the same without the station."""

    def __init__(self, worlds: int, steps_per_update: int) -> None:
        setup = make_setup(
            Scenario(
                object="t_block",
                theta=Theta(friction_floor=0.1, friction_pusher=0.1),
                physics=Physics(steps_per_update=steps_per_update),
                camera=View(width=64, height=64),
                start=Start(pusher_angle=[np.pi, np.pi], pusher_gap=[0.0, 0.0]),
                num_worlds=worlds,
            )
        )
        self.scene: SceneStation = make_station(setup, "twin")
        context = self.scene.CreateDefaultContext()
        v_WP = np.tile([SPEED, 0.0, 0.0], worlds)
        self.scene.GetInputPort("pusher_velocity_W").FixValue(context, v_WP)
        simulator = Simulator(self.scene, context)
        simulator.AdvanceTo(WARM_UP)
        self.context, self.simulator, self.image = context, simulator, self.scene.GetOutputPort("rgb_batch")
        world = self.scene.world
        mine = world.GetMyContextFromRoot(context)
        self.start = [mine.get_discrete_state(k).value().copy() for k in (0, 1)]
        parameters = world.GetParameters(mine)
        self.theta = tuple(values.numpy() for values in parameters.tensors())
        objects, pushers = self.start[0].reshape(worlds, -1), self.start[1].reshape(worlds, -1)
        q_WP = np.tile([1.0, 0.0, 0.0, 0.0], (worlds, 1))
        self.state = (objects[:, None, :4], objects[:, None, 4:7], objects[:, None, 7:], q_WP, pushers[:, :3])
        self.updates = STEPS // steps_per_update
        self.V_WP = np.zeros((steps_per_update, worlds, 6))
        self.V_WP[:, :, 3] = SPEED
        self.stepper = Stepper(world.physics.scene.model)
        self.surfels, self.camera = setup.twin.surfels, setup.camera
        X_CW = setup.X_WC.inverse()
        self.R_CW, self.p_CW = X_CW.rotation().matrix(), X_CW.translation()
        # The block hardly turns in this push: the bare loop renders it unturned.
        self.q_CO = torch.tensor(X_CW.rotation().ToQuaternion().wxyz()).expand(worlds, 4).contiguous()

    def prepare(self) -> None:
        """Goes back to the start of the action."""
        self.context.SetTime(WARM_UP)
        mine = self.scene.world.GetMyMutableContextFromRoot(self.context)
        for k, values in enumerate(self.start):
            mine.SetDiscreteState(k, values)
        self.simulator.Initialize()

    def station(self) -> None:
        """Take the action in the station's diagram."""
        self.simulator.AdvanceTo(WARM_UP + STEPS / 240 - 1e-6)
        self.image.Eval(self.context)

    def bare(self) -> None:
        """Take the action without the station."""
        state, V_WP = State(*(torch.from_numpy(np.ascontiguousarray(part)) for part in self.state)), self.V_WP
        parameters = Parameters(*(torch.from_numpy(values) for values in self.theta))
        velocities = torch.from_numpy(V_WP)
        for _ in range(self.updates):
            state = self.stepper.rollout(parameters, state, velocities, record_every=len(V_WP)).frame(-1)
        self._render(state.p_WB[:, 0].numpy())

    def unchecked(self) -> None:
        """Take the action without the station, and without any check."""
        state = self.state
        for _ in range(self.updates):
            frames = self.stepper.roll(self.theta, state, self.V_WP, len(self.V_WP), keep=False)[4]
            state = tuple([array[1] for array in frames[:5]])
        self._render(state[1][:, 0])

    def _render(self, p_WB: np.ndarray) -> None:
        p_CO = torch.from_numpy(p_WB @ self.R_CW.T + self.p_CW)
        render(self.surfels, self.camera, Pose(self.q_CO, p_CO), full=False)


def measure(given: argparse.Namespace) -> dict:
    """Time an action with and without the station, in turn."""
    cases = {}
    for worlds in BARS:
        for steps in (1, STEPS):
            action = Action(worlds, steps)
            for kind in ("station", "bare", "unchecked"):
                cases[f"{worlds} {steps} {kind}"] = timing.Case(getattr(action, kind), action.prepare)
    samples = timing.interleave(cases, given.rounds)
    names = [f"{worlds} {steps}" for worlds in BARS for steps in (1, STEPS)]
    return {
        "milliseconds": {name: sample.summary(1e3) for name, sample in samples.items()},
        "ratio": {name: samples[f"{name} station"].over(samples[f"{name} bare"]) for name in names},
        "ratio_unchecked": {name: samples[f"{name} station"].over(samples[f"{name} unchecked"]) for name in names},
    }


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    rows, verdicts = [], []
    for name, ratio in data["ratio"].items():
        worlds, steps = name.split()
        times = [results.spread(data["milliseconds"][f"{name} {kind}"], 2) for kind in ("bare", "unchecked", "station")]
        ratios = [results.spread(one, 2) for one in (ratio, data["ratio_unchecked"][name])]
        rows.append([worlds, steps, *times, *ratios])
        overhead = results.verdict(ratio["median"] - 1, BARS[int(worlds)])
        verdicts.append(f"- {worlds} worlds, {steps} steps an update: overhead {overhead}.")
    header = "worlds | steps an update | bare, ms an action | unchecked, ms | station, ms | over bare | over unchecked"
    tail = f"{data['rounds']} rounds on two threads; other processes took {data['load']:.0f} % of the CPUs."
    return "\n".join([*results.markdown(header, rows), "", *verdicts, "", tail])


if __name__ == "__main__":
    results.run("station", __doc__ or "", measure, table, rounds=40)
