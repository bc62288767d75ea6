"""A station that is driven action by action."""

from collections.abc import Mapping

import numpy as np
import torch
from pydrake.systems.analysis import Simulator

from pinwm_drake.cousins import Cousin
from pinwm_drake.errors import SolverError
from pinwm_drake.systems.engines.twin.cousins import SetCousin
from pinwm_drake.systems.engines.twin.world_model import WorldModel
from pinwm_drake.systems.scenario.load import longest_translation
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import MakePushStation

FAILURES = (SolverError, RuntimeError)  # of the twin, and of Drake's plants


class PushRun:
    """A station, its Simulator, and a translation an action.

    Attributes:
        setup: Of `environment_setup`: one update of the state an action.
        station: The station; its input is `pusher_translation_W`.
        num_worlds: W.
    """

    def __init__(self, setup: Setup, engine: str | None, max_translation: float | None) -> None:
        """Makes the station.

        Args:
            setup: The scene.
            engine: "twin", "hydroelastic" or "point"; None for that of the scenario.
            max_translation: m, the longest in an action; None for what the pusher's speed allows.

        Raises:
            ParameterError: The translation is not positive, or longer than the pusher's speed allows.
        """
        self.max_translation = longest_translation(setup, max_translation)
        self.setup, self.num_worlds = setup, setup.scenario.num_worlds
        self.station = MakePushStation(setup, engine, command="translation")
        self._simulator = Simulator(self.station)
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

    def again(self) -> None:
        """Makes the next `advance` do what the one that failed did not."""
        self._simulator.Initialize()

    def place(self, place: Place, world: int = 0) -> None:
        """Puts object and pusher of a world into place, at rest."""
        self.station.SetPlace(self._context, place, world)

    def put(self, object_state: np.ndarray, p_WP: np.ndarray, world: int) -> None:
        """Puts object (13,) and pusher (3,) m of one of the twin's worlds into a state."""
        model, object_state = self._world_model, object_state.copy()
        object_state[:4] /= np.linalg.norm(object_state[:4])
        model.SetState(model.GetMyMutableContextFromRoot(self._context), object_state, p_WP, world)

    def become(self, cousin: Cousin, world: int, *, colours: bool = True) -> None:
        """Makes one of the twin's worlds a cousin.

        Args:
            cousin: The cousin.
            world: Which.
            colours: Whether it is to look like the cousin too; drawing colours takes longer than some actions.

        Raises:
            PinwmError: A value is out of range, or the surfels are not those of the twin.
        """
        SetCousin(self._world_model, self._context, cousin, world, colors=colours)

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that changes in the twin's worlds, for `set_state`: motion, theta, colours, number of actions."""
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
        """Puts what `get_state` gave back."""
        self._actions = int(arrays["actions"])
        self._context.SetTime(self._actions * self.setup.period)
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
        model = self.station.world
        assert model is not None
        return model

    def translation(self, action: np.ndarray) -> np.ndarray:
        """d_W (W, 2) m, no longer than `max_translation`, of actions (W, 2) in [-1, 1]^2; nothing where not finite."""
        action = np.asarray(action, float).reshape(self.num_worlds, 2)
        action = np.where(np.isfinite(action).all(axis=1)[:, None], np.clip(action, -1.0, 1.0), 0.0)
        length = np.hypot(action[:, :1], action[:, 1:])
        d_W: np.ndarray = self.max_translation * action / np.maximum(length, 1.0)
        return d_W

    def advance(self, action: np.ndarray) -> None:
        """Goes on by one action (W, 2).

        Raises:
            SolverError, RuntimeError: The contacts have no solution that is found; see `FAILURES`.
        """
        values = np.zeros((self.num_worlds, 3))
        values[:, :2] = self.translation(action)
        self._d_W.GetMutableData().get_mutable_value().SetFromVector(values.ravel())
        self._simulator.AdvanceTo((self._actions + 1) * self.setup.period)
        self._actions += 1

    @property
    def object_state(self) -> np.ndarray:
        """(W, 13)."""
        return self._object.Eval(self._context).reshape(self.num_worlds, 13)

    @property
    def p_WP(self) -> np.ndarray:
        """(W, 3) m."""
        return self._pusher.Eval(self._context).reshape(self.num_worlds, 6)[:, :3]

    def images(self) -> np.ndarray:
        """(W, height, width, 4) uint8, as the station's port has them."""
        images: np.ndarray = self._rgb.Eval(self._context)
        return images

    def images_of(self, worlds: np.ndarray) -> np.ndarray:
        """(m, height, width, 4) uint8 of some of the twin's worlds (m,), without rendering the others."""
        model = self._world_model
        return model.TakePictures(model.GetMyContextFromRoot(self._context), worlds)
