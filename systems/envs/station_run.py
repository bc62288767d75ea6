# SPDX-License-Identifier: MIT
"""A station that is driven action by action, by translations of the pusher."""

import dataclasses
from collections.abc import Mapping

import numpy as np
import torch
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from pinwm_drake.cousins.cousin import Cousin
from pinwm_drake.errors import SolverError
from pinwm_drake.systems.engines.twin.domains import SetDomain
from pinwm_drake.systems.engines.twin.world_model import WorldModel
from pinwm_drake.systems.envs.options import longest_translation
from pinwm_drake.systems.ports import free_with
from pinwm_drake.systems.sampling import whole_multiple
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import make_station

_MOST_PARTS = 8
FAILURES = (SolverError, RuntimeError)  # errors of the twin's physics, and of Drake's plants


class StationRun:
    """A station with its Simulator, which advances by one translation an action.

    Args:
        setup: The scene, as `environment_setup` makes it.
        engine: "twin", "hydroelastic" or "point"; None for that of the scenario.
        max_translation: m, the longest in an action; None for the longest that the pusher's speed allows.
        parts: Number of equal parts of an action, each of which may have a translation of its own.

    Attributes:
        station: The station; its input is `pusher_translation_W`.
        num_worlds: Number of worlds, W.
        world_model: The twin's worlds; None with other engines.

    Raises:
        ParameterError: The translation is not positive, or longer than the pusher's speed allows.
    """

    def __init__(self, setup: Setup, engine: str | None, max_translation: float | None, parts: int = 1) -> None:
        self.max_translation = longest_translation(setup, max_translation)
        self.setup, self.num_worlds = setup, setup.scenario.num_worlds
        self._parts, inner = parts, _divided(setup, parts)
        self._period = inner.period
        self.station = make_station(inner, engine, command="translation")
        self.world_model = self.station.world
        self._simulator = Simulator(self.station)
        free_with(self, self.station)
        self._context = self._simulator.get_mutable_context()
        groups = range(self._context.num_discrete_state_groups())
        self._begin = [self._context.get_discrete_state(group).value().copy() for group in groups]
        d_W = self.station.get_input_port().FixValue(self._context, np.zeros(3 * self.num_worlds))
        self._d_W = d_W
        self._object, self._pusher, self._rgb = (
            self.station.GetOutputPort(name) for name in ("object_state", "pusher_state", "rgb_batch")
        )
        self.restart()

    def restart(self) -> None:
        """Goes back to time 0 and to the scenario's middle start, with everything at rest."""
        self._context.SetTime(0.0)
        # The numbers alone: a new Context, or a default one, would copy the renderers too.
        for group, values in enumerate(self._begin):
            self._context.SetDiscreteState(group, values)
        self._actions = 0
        self._simulator.Initialize()

    def retry(self) -> None:
        """Prepare a second try of the action that failed, after worlds have been put elsewhere."""
        self._simulator.Initialize()

    def place(self, place: Place, world: int = 0) -> None:
        """Put object and pusher of a world into place, at rest."""
        self.station.SetPlace(self._context, place, world)

    def set_world_state(self, object_state: np.ndarray, p_WP: np.ndarray, world: int | None = None) -> None:
        """Set the state of object and pusher in one of the twin's worlds, or in all of them.

        Args:
            object_state: (13,) q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world; (W, 13) of all worlds.
            p_WP: (3,) m, world: position of the pusher; (W, 3) of all worlds.
            world: Index of the world; None for all.
        """
        model, object_state = self._world_model, object_state.copy()
        object_state[..., :4] /= np.linalg.norm(object_state[..., :4], axis=-1, keepdims=True)
        model.SetState(model.GetMyMutableContextFromRoot(self._context), object_state, p_WP, world)

    def set_domain(self, domain: Cousin, world: int, *, colours: bool = True) -> None:
        """Give one of the twin's worlds the theta and, if wanted, the colours of a domain; see `SetDomain`."""
        SetDomain(self._world_model, self._context, domain, world, colors=colours)

    def set_camera(self, X_WC: RigidTransform) -> None:
        """Put the cameras of all of the twin's worlds elsewhere; OpenCV axes."""
        model = self._world_model
        model.SetCamera(model.GetMyMutableContextFromRoot(self._context), X_WC)

    def set_light(self, light: np.ndarray, world: int) -> None:
        """Set the light (4,) of one of the twin's worlds; see `WorldModel.SetLight`."""
        model = self._world_model
        model.SetLight(model.GetMyMutableContextFromRoot(self._context), light, world)

    def get_state(self) -> dict[str, np.ndarray]:
        """What changes in the twin's worlds, for `set_state`: motion, theta, colours, cameras, lights, actions."""
        model, groups = self._world_model, range(len(self._begin))
        states = {f"discrete.{group}": self._context.get_discrete_state(group).value().copy() for group in groups}
        mine = model.GetMyContextFromRoot(self._context)
        parameters = {
            f"numeric.{number}": mine.get_numeric_parameter(number).CopyToVector()
            for number in range(mine.num_numeric_parameter_groups())
        }
        sh = model.GetColors(mine)
        # Colours that all worlds share are those of the twin.
        return (
            states
            | parameters
            | ({"sh": sh.numpy().copy()} if sh.ndim == 4 else {})
            | {"actions": np.array(self._actions)}
        )

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `get_state`."""
        self._actions = int(arrays["actions"])
        self._context.SetTime(self._actions * self._parts * self._period)
        for group in range(len(self._begin)):
            self._context.SetDiscreteState(group, arrays[f"discrete.{group}"])
        model = self._world_model
        mine = model.GetMyMutableContextFromRoot(self._context)
        for number in range(mine.num_numeric_parameter_groups()):
            mine.get_mutable_numeric_parameter(number).SetFromVector(arrays[f"numeric.{number}"])
        model.SetColors(mine, torch.from_numpy(arrays["sh"]) if "sh" in arrays else self.setup.twin.surfels.sh)
        self._simulator.Initialize()

    @property
    def _world_model(self) -> WorldModel:
        assert self.world_model is not None
        return self.world_model

    def advance(self, action: np.ndarray) -> None:
        """Simulate one action (W, action_size) in [-1, 1], along the axes of the scene's task.

        The worlds of a twin stay at its beginning where it fails.

        Args:
            action: (W, action_size) of the whole action, or (parts, W, action_size) of its parts.

        Raises:
            SolverError, RuntimeError: The contacts have no solution that is found; see `FAILURES`.
        """
        each = np.broadcast_to(action, (self._parts, *np.shape(action)[-2:]))
        groups = range(len(self._begin) if self._parts > 1 and self.world_model is not None else 0)
        before = [self._context.get_discrete_state(group).value().copy() for group in groups]
        for number, part in enumerate(each, 1):
            d_W = self.setup.task.translation(part, self.max_translation) / self._parts
            self._d_W.GetMutableData().get_mutable_value().SetFromVector(d_W.ravel())
            try:
                self._simulator.AdvanceTo((self._actions * self._parts + number) * self._period)
            except FAILURES:
                if before:
                    self._context.SetTime(self._actions * self._parts * self._period)
                elif self.world_model is None and self._parts > 1:
                    self._actions += 1  # a plant is not put back: the next action ends after this one
                for group, values in enumerate(before):
                    self._context.SetDiscreteState(group, values)
                raise
        self._actions += 1

    @property
    def object_state(self) -> np.ndarray:
        """States (W, 13) of the objects: q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world."""
        return self._object.Eval(self._context).reshape(self.num_worlds, 13)

    @property
    def pusher_impulse(self) -> np.ndarray | None:
        """Sums (W,) N s of the norms of the impulses from pushers to objects so far; None where it is no twin."""
        model = self.world_model
        if model is None:
            return None
        return model.GetPusherImpulse(model.GetMyContextFromRoot(self._context))

    @property
    def p_WP(self) -> np.ndarray:
        """Positions (W, 3) m of the pushers, world."""
        return self._pusher.Eval(self._context).reshape(self.num_worlds, 6)[:, :3]

    def images(self) -> np.ndarray:
        """Images (W, height, width, 4) uint8 RGBA of all worlds, as the station's port has them."""
        return np.asarray(self._rgb.Eval(self._context))

    def images_of(self, worlds: np.ndarray) -> np.ndarray:
        """Images (m, height, width, 4) uint8 RGBA of the twin's worlds with indices (m,), without rendering others."""
        model = self._world_model
        return model.TakePictures(model.GetMyContextFromRoot(self._context), worlds)


def most_parts(setup: Setup) -> int:
    """Return the number of equal parts of an action, at most 8, of whole steps of the twin and of the plants."""
    steps = setup.scenario.physics.steps_per_update
    plant = whole_multiple("pusher.horizon", setup.period, setup.plant_time_step, "plant.time_step")
    return next(parts for parts in range(_MOST_PARTS, 0, -1) if steps % parts == 0 and plant % parts == 0)


def _divided(setup: Setup, parts: int) -> Setup:
    """Return the setup whose worlds and pusher take a command for each of the equal parts of an action."""
    scenario = setup.scenario
    physics = dataclasses.replace(scenario.physics, steps_per_update=scenario.physics.steps_per_update // parts)
    pusher = dataclasses.replace(scenario.pusher, horizon=scenario.pusher.horizon / parts)
    scenario = dataclasses.replace(scenario, physics=physics, pusher=pusher)
    return setup if parts == 1 else dataclasses.replace(setup, scenario=scenario, period=setup.period / parts)
