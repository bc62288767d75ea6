# SPDX-License-Identifier: MIT
"""Stations with a T-block for tests, and what is read of them."""

from functools import cache
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.scenario.load import Scene, load_setup
from pinwm_drake.systems.scenario.schema import Pusher, Scenario, Start, Theta, View
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import SceneStation, make_station

H = 1 / 240
MASS, FRICTION = 0.8, 0.1
FAR = np.array([0.0, 0.3, 0.05])  # m, where the pusher touches nothing
LOW, HIGH = [-0.4, -0.4, 0.01], [0.4, 0.4, 0.2]
REST = RigidTransform([0.0, 0.0, 0.025])
TURNED = RigidTransform(RollPitchYaw(0.0, 0.0, 0.6), [0.03, -0.02, 0.025])


def scenario(**changes: object) -> Scenario:
    return Scenario(
        object="t_block",
        theta=Theta(mass=MASS, friction_floor=FRICTION, friction_pusher=FRICTION),
        pusher=Pusher(max_speed=0.5, low=LOW, high=HIGH),
        camera=View(width=96, height=80),
        # The pusher stands before the stem's end.
        start=Start(
            x=[-0.05, 0.05], y=[-0.05, 0.05], yaw=[-0.2, 0.2], pusher_angle=[1.4, 1.7], pusher_gap=[0.0, 0.001]
        ),
        **changes,
    )


@cache
def setup_of() -> Setup:
    return make_setup(scenario())


def action_setup(scene: Scene = "push_t", num_worlds: int = 1, **options: Any) -> Setup:
    """The setup of an environment with some options."""
    return environment_setup(load_setup(scene), EnvOptions(**options), num_worlds=num_worlds)


@cache
def station_of(engine: str) -> SceneStation:
    """A station that is in no other diagram."""
    return make_station(setup_of(), engine)


@cache
def translated(engine: str) -> SceneStation:
    """A station that takes translations."""
    return make_station(setup_of(), engine, command="translation")


def moved(*d: float) -> np.ndarray:
    """(3,) m, at d from `FAR`."""
    return FAR + np.array(d)


def started(station: SceneStation, X_WO: RigidTransform = REST, p_WP: np.ndarray = FAR) -> Context:
    """A context with everything at rest, and a pusher that is told to stay."""
    context = station.CreateDefaultContext()
    station.SetPlace(context, Place(X_WO, p_WP))
    station.get_input_port().FixValue(context, np.zeros(3))
    return context


def output(station: SceneStation, context: Context, name: str) -> Any:
    return station.GetOutputPort(name).Eval(context)


def after(station: SceneStation, context: Context, periods: int) -> np.ndarray:
    """(19,): object and pusher, some periods later."""
    # The time of a period's end to the last bit: a later one would begin the next.
    Simulator(station, context).AdvanceTo((round(context.get_time() / H) + periods) * H)
    return np.concatenate([output(station, context, "object_state"), output(station, context, "pusher_state")])
