"""The worlds that a policy is trained in: cousins of a twin, or the twin alone."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pinwm_drake.checkpoints import generator_state, set_generator_state
from pinwm_drake.cousins import Cousin, CousinDraw
from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.spec import Observes, PolicySpec
from pinwm_drake.systems.envs.observation import Kind
from pinwm_drake.systems.envs.policy_scene import policy_spec
from pinwm_drake.systems.envs.vector import PushVecEnv
from pinwm_drake.systems.scenario.load import Scene, environment_setup, scene_hash, with_start_yaw
from pinwm_drake.tasks.push import PushTask

# Twelve steps of physics an action, and eight directions of friction: tenths of a millimetre do not count here.
_TIME_STEP, _DIRECTIONS = 1 / 120, 8
_POOL = 64  # cousins in a round


class TrainingWorlds:
    """Makes worlds, for the state and for images, in which the same cousins live.

    Attributes:
        setup: The scene, of one world.
        pool: Where episodes get their cousins; None where all are the twin.
        about: What the worlds are, as JSON takes it.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        num_worlds: int = 64,
        image_size: int = 64,
        frames: int = 3,
        max_translation: float = 0.02,
        max_steps: int = 100,
        delta: float = 0.1,
        from_intervals: bool = False,
        seed: int = 0,
        yaw: float | None = None,
        tolerance: float = PushTask.tolerance,
        turn_tolerance: float = PushTask.turn_tolerance,
    ) -> None:
        """Loads the scene.

        Args:
            scene: The folder of a twin, or what else `PushWorlds` takes.
            num_worlds: W.
            image_size: px, width and height.
            frames: Of images that a policy sees.
            max_translation: m, in an action.
            max_steps: Of an episode.
            delta: Of the cousins; 0 for the twin alone.
            from_intervals: Whether cousins' theta is drawn from identified intervals.
            seed: Of the cousins.
            yaw: rad, by which the object is turned at the start at most, either way; None for the scene's range.
            tolerance: m, how near to the goal is success.
            turn_tolerance: rad, likewise of the orientation.

        Raises:
            InputError: The scene, or one of its files, cannot be used.
            ParameterError: An option is out of range.
        """
        setup = environment_setup(scene, time_step=_TIME_STEP, friction_directions=_DIRECTIONS, image_size=image_size)
        if yaw is not None:
            setup = with_start_yaw(setup, yaw)
        self.setup, self._worlds = setup, num_worlds
        self._options: dict[str, Any] = {
            "frames": frames,
            "max_steps": max_steps,
            "max_translation": max_translation,
            "tolerance": tolerance,
            "turn_tolerance": turn_tolerance,
            "time_step": _TIME_STEP,
            "friction_directions": _DIRECTIONS,
        }
        draw = CousinDraw(setup.twin, delta=delta, from_intervals=from_intervals, seed=seed)
        self.pool = CousinPool(draw, _POOL) if delta > 0 or from_intervals else None
        self.about: dict[str, object] = {
            "scene": setup.scenario.name,
            "scene_sha256": scene_hash(setup),
            "delta": delta,
            "from_intervals": from_intervals,
            "cousin_seed": seed,
            "start_yaw": list(setup.scenario.start.yaw),
        }

    def worlds(self, observation: Kind) -> PushVecEnv:
        """Worlds of one diagram, with the shaped reward."""
        return PushVecEnv(
            self.setup,
            self._worlds,
            observation=observation,
            reward="shaped",
            on_reset=self.pool,
            **self._options,
        )

    def spec(self, env: PushVecEnv, observes: Observes) -> PolicySpec:
        """Of a policy that acts in worlds that were made here."""
        keys = ("frames", "max_translation", "max_steps")
        return policy_spec(
            self.setup, env.worlds.task, observes=observes, **{name: self._options[name] for name in keys}
        )

    def begin(self, seed: int) -> None:
        """Draws the cousins of a round."""
        if self.pool is not None:
            self.pool.begin(seed)


class CousinPool:
    """Gives each episode one of a number of cousins; a round of the training has cousins of its own.

    Meant as `PushWorlds.on_reset`.

    Attributes:
        draw: Where the cousins come from.
        size: How many there are in a round.
    """

    def __init__(self, draw: CousinDraw, size: int = 64) -> None:
        """Draws the first round's.

        Args:
            draw: Of the twin.
            size: 1 or more.

        Raises:
            ParameterError: The size is out of range.
        """
        if size < 1:
            raise ParameterError(f"size: got {size}; allowed: 1 or more")
        self.draw, self.size = draw, size
        self.begin(0)

    def begin(self, seed: int) -> None:
        """Draws other cousins, which follow from a seed."""
        self._random = np.random.default_rng(seed)
        numbers = self._random.integers(1 << 31, size=self.size)
        self._members = [self.draw.cousin(int(number)) for number in numbers]

    def get_state(self) -> dict[str, np.ndarray]:
        """State of the draw, for `set_state`; the cousins follow from `begin`."""
        return {"generator": generator_state(self._random)}

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Puts what `get_state` gave back."""
        set_generator_state(self._random, arrays["generator"])

    def __call__(self, world: int) -> Cousin:
        """The cousin that a world becomes."""
        return self._members[int(self._random.integers(self.size))]
