"""The push task as a gymnasium environment over a station of any engine."""

from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from pydrake.math import RigidTransform

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.observation import Kind, Observation, PushObserver
from pinwm_drake.systems.envs.picture import PushPicture
from pinwm_drake.systems.envs.station_run import FAILURES, PushRun
from pinwm_drake.systems.scenario.load import Scene, environment_setup
from pinwm_drake.systems.scenario.schema import ENGINES
from pinwm_drake.systems.scenario.start import Place, StartDistribution
from pinwm_drake.tasks.push import Progress, PushTask, Reward

OPTIONS = ("place", "X_WO", "p_WP")


class PushEnv(gymnasium.Env[Observation, np.ndarray]):
    """An object is to be pushed to a goal.

    An action in [-1, 1]^2 is a translation of the pusher along the world's x and y in units of `max_translation`, no
    longer than one such, over 0.1 s (the scenario's `pusher.horizon`); its height does not change. Observations:
    `PushObserver`; rewards and success: `PushTask`. An episode terminates with success, and is truncated after
    `max_steps`, or when the physics finds no solution (`info["failure"]` says why).

    `info`: `distance` [m], `angle` [rad], `success`, `step` and `engine`; after a failure also `failure`.

    Attributes:
        setup: The scene.
        task: Goal, reward and tolerances.
        run: The station, and what drives it.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012  # as gymnasium has it

    def __init__(
        self,
        scenario: Scene = "push_t",
        engine: str | None = None,
        *,
        observation: Kind = "state",
        frames: int = 1,
        reward: Reward = "paper",
        goal: tuple[float, float, float] = (0.0, 0.0, 0.0),
        tolerance: float = PushTask.tolerance,
        turn_tolerance: float = PushTask.turn_tolerance,
        max_steps: int = 100,
        max_translation: float | None = None,
        time_step: float | None = None,
        friction_directions: int | None = None,
        image_size: int | None = None,
        render_mode: Literal["rgb_array"] | None = None,
    ) -> None:
        """Makes the station.

        Args:
            scenario: A scenario or setup, the name of a scenario that ships, its path, or the folder of a twin.
            engine: "twin", "hydroelastic" or "point"; None for that of the scenario.
            observation: "state", "rgb", or "rgb_state" for both.
            frames: How many of the last images are seen.
            reward: "paper" or "shaped".
            goal: x [m], y [m], yaw [rad] of the object.
            tolerance: m, how near to the goal is success.
            turn_tolerance: rad, likewise of the orientation.
            max_steps: After which an episode is truncated.
            max_translation: m, in an action; None for what the pusher's speed allows.
            time_step: s, of the twin's physics; None for that of the scene.
            friction_directions: Of the twin's physics; None for those of the scene.
            image_size: px, width and height of images; None for those of the scene.
            render_mode: "rgb_array", or None.

        Raises:
            InputError: The scenario, or one of its files, cannot be used.
            ParameterError: An option is none of those allowed.
        """
        if render_mode not in (None, "rgb_array"):
            raise ParameterError(f"render_mode: got {render_mode!r}; allowed: rgb_array, or None")
        if engine is not None and engine not in ENGINES:
            raise ParameterError(f"engine: got {engine!r}; allowed: {', '.join(ENGINES)}")
        self.max_steps = whole_steps(max_steps)
        self.setup = environment_setup(
            scenario, time_step=time_step, friction_directions=friction_directions, image_size=image_size
        )
        self.task = make_task(self.setup.scenario.start.q_WO, goal, reward, tolerance, turn_tolerance)
        self.run = PushRun(self.setup, engine, max_translation)
        self.engine = self.run.station.engine.name
        self._observer = PushObserver(self.setup, self.task, observation, frames)
        self._start = StartDistribution(self.setup)
        self._picture: PushPicture | None = None
        self.render_mode = render_mode
        self.observation_space = self._observer.space
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._steps, self._progress = 0, self._measure()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode.

        Args:
            seed: Of this episode and those that follow; None goes on with the last one's generator.
            options: {"place": Place}, or any of {"X_WO": RigidTransform, "p_WP": (3,) m}: where things are, in place
                of what the scenario's start draws.

        Raises:
            ParameterError: There is no such option.
        """
        super().reset(seed=seed)
        place = chosen_place(self._start.draw(self.np_random), options)
        self.run.restart()
        self.run.place(place)
        self._steps, self._progress = 0, self._measure()
        if self._observer.needs_images:
            self._observer.begin(np.array([0]), self.run.images())
        return self._observe(), self._info()

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Goes on by one action (2,) in [-1, 1]^2."""
        before, failure = self._progress, ""
        self._steps += 1
        last = self.run.object_state.copy(), self.run.p_WP.copy()
        try:
            self.run.advance(np.asarray(action)[None])
            if not np.isfinite(self.run.object_state).all():
                failure = "the object's state is not finite"
        except FAILURES as error:
            failure = str(error)
        if failure:
            # What is seen is what was seen last: where there is no solution, nothing has happened.
            info = self._info() | {"failure": failure}
            return (
                self._first(self._observer.observe(*last)),
                float(self.task.rewards(before, before)[0]),
                False,
                True,
                info,
            )
        self._progress = self._measure()
        if self._observer.needs_images:
            self._observer.see(self.run.images())
        terminated = bool(self._progress.success[0])
        truncated = self._steps >= self.max_steps and not terminated
        reward = float(self.task.rewards(before, self._progress)[0])
        return self._observe(), reward, terminated, truncated, self._info()

    def render(self) -> np.ndarray | None:
        """The camera's picture (height, width, 3) uint8 with goal and pusher, or None without a render mode."""
        if self.render_mode is None:
            return None
        self._picture = self._picture or PushPicture(self.setup, self.task)
        return self._picture.draw(self.run.images()[0], self.run.p_WP[0])

    def _measure(self) -> Progress:
        return self.task.measure(self.run.object_state, self.run.p_WP)

    def _observe(self) -> Observation:
        return self._first(self._observer.observe(self.run.object_state, self.run.p_WP))

    @staticmethod
    def _first(observation: Observation) -> Observation:
        if isinstance(observation, dict):
            return {name: values[0] for name, values in observation.items()}
        return observation[0]

    def _info(self) -> dict[str, Any]:
        progress = self._progress
        return {
            "distance": float(progress.distance[0]),
            "angle": float(progress.angle[0]),
            "success": bool(progress.success[0]),
            "step": self._steps,
            "engine": self.engine,
        }


def make_task(
    q_WO: list[float],
    goal: tuple[float, float, float],
    reward: Reward,
    tolerance: float = PushTask.tolerance,
    turn_tolerance: float = PushTask.turn_tolerance,
) -> PushTask:
    """The task of an object that lies as q_WO (4,) says; the rest as `PushTask` has it."""
    w, x, y, z = (float(value) for value in q_WO)
    a, b, yaw = (float(value) for value in goal)
    return PushTask((a, b, yaw), (w, x, y, z), reward, float(tolerance), float(turn_tolerance))


def whole_steps(max_steps: int) -> int:
    """The number of steps, if there is one at least; raises ParameterError otherwise."""
    if max_steps < 1:
        raise ParameterError(f"max_steps: got {max_steps}; allowed: 1 or more")
    return int(max_steps)


def chosen_place(drawn: Place, options: dict[str, Any] | None) -> Place:
    """A place with what the options of a reset say; raises ParameterError where there is no such option."""
    options = options or {}
    for name in options:
        if name not in OPTIONS:
            raise ParameterError(f"options: got {name!r}; allowed: {', '.join(OPTIONS)}")
    place = options.get("place", drawn)
    X_WO, p_WP = options.get("X_WO", place.X_WO), np.asarray(options.get("p_WP", place.p_WP), float)
    if not isinstance(X_WO, RigidTransform):
        raise ParameterError(f"X_WO: got a {type(X_WO).__name__}; allowed: a RigidTransform")
    if p_WP.shape != (3,) or not np.isfinite(p_WP).all():
        raise ParameterError(f"p_WP: got {p_WP.tolist()}; allowed: three finite numbers, m")
    return Place(X_WO, p_WP)
