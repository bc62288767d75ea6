"""The push task in many worlds of one twin at once, each of which begins anew when its episode ends."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from pinwm_drake.checkpoints import Resumable, generator_state, set_generator_state
from pinwm_drake.cousins import Cousin
from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.env import chosen_place, make_task, whole_steps
from pinwm_drake.systems.envs.observation import Kind, Observation, PushObserver
from pinwm_drake.systems.envs.station_run import FAILURES, PushRun
from pinwm_drake.systems.scenario.load import Scene, environment_setup
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.tasks.push import Progress, PushTask, Reward

_RESET = "on_reset."
OnReset = Callable[[int], Cousin | None]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of one action in W worlds.

    Attributes:
        observation: Of all worlds; of those that ended, the first of the next episode.
        reward: (W,).
        terminated: (W,) bool.
        truncated: (W,) bool.
        progress: At the end of the action.
        steps: (W,) int, of the episodes, that action included.
        ended: (m,) int: the worlds whose episodes ended.
        last: What these m worlds saw last; None where m is 0.
        failures: Why the physics of a world failed.
    """

    observation: Observation
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    progress: Progress
    steps: np.ndarray
    ended: np.ndarray
    last: Observation | None
    failures: dict[int, str]


class PushWorlds:
    """W worlds of one diagram; actions, observations, rewards and ends are those of `PushEnv`.

    World k draws its starts from a generator of its own, seeded with `seed + k`, so that its first episode is that of
    a `PushEnv` with this seed, and the next ones do not depend on the other worlds.

    Attributes:
        setup: The scene.
        task: Goal, reward and tolerances.
        run: The station, and what drives it.
        observation_space: Of one world.
        on_reset: Called with a world's index before it begins an episode; gives the cousin that it becomes, or None.
            Its colours are not asked for where no images are seen.
    """

    def __init__(
        self,
        scenario: Scene = "push_t",
        num_worlds: int = 32,
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
        on_reset: OnReset | None = None,
    ) -> None:
        """Makes the station; see `PushEnv` for the options.

        Raises:
            InputError: The scenario, or one of its files, cannot be used.
            ParameterError: An option is none of those allowed.
        """
        if num_worlds < 1:
            raise ParameterError(f"num_envs: got {num_worlds}; allowed: 1 or more")
        self.max_steps, self.on_reset = whole_steps(max_steps), on_reset
        self.setup = environment_setup(
            scenario,
            num_worlds=num_worlds,
            time_step=time_step,
            friction_directions=friction_directions,
            image_size=image_size,
        )
        self.task = make_task(self.setup.scenario.start.q_WO, goal, reward, tolerance, turn_tolerance)
        self.run = PushRun(self.setup, "twin", max_translation)
        self._observer = PushObserver(self.setup, self.task, observation, frames)
        self.observation_space = self._observer.space
        self._start = StartDistribution(self.setup)
        self._steps = np.zeros(num_worlds, int)
        self._random = [seeding.np_random(None)[0] for _ in range(num_worlds)]
        self._progress = self._measure()

    @property
    def progress(self) -> Progress:
        """Where the worlds stand now."""
        return self._progress

    @property
    def num_worlds(self) -> int:
        """W."""
        return self.run.num_worlds

    def reset(
        self, seeds: Sequence[int | None] | None = None, options: Sequence[dict[str, Any] | None] | None = None
    ) -> Observation:
        """Begins an episode in every world.

        Args:
            seeds: (W,) of the worlds' generators; None goes on with a generator, or with all.
            options: (W,) see `PushEnv.reset`.

        Raises:
            ParameterError: There is no such option, or not one for each world.
        """
        for name, given in (("seeds", seeds), ("options", options)):
            if given is not None and len(given) != self.num_worlds:
                raise ParameterError(f"{name}: got {len(given)}; allowed: {self.num_worlds}, one for each world")
        for world, seed in enumerate(seeds or ()):
            if seed is not None:
                self._random[world] = seeding.np_random(seed)[0]
        self.run.restart()
        self._begin(np.arange(self.num_worlds), options)
        return self._observer.observe(self.run.object_state, self.run.p_WP)

    def step(self, actions: np.ndarray) -> Outcome:
        """Goes on by one action (W, 2) in [-1, 1]^2."""
        before = self._progress
        self._steps += 1
        failures = self._advance(actions)
        progress = self._progress = self._measure()
        failed = np.zeros(self.num_worlds, bool)
        failed[list(failures)] = True
        terminated = progress.success & ~failed
        truncated = failed | ((self._steps >= self.max_steps) & ~terminated)
        reward, steps = self.task.rewards(before, progress), self._steps.copy()
        if self._observer.needs_images:
            self._observer.see(self.run.images())
        ended, last = np.flatnonzero(terminated | truncated), None
        if len(ended):
            last = self._observer.observe(self.run.object_state, self.run.p_WP, ended)
            self._begin(ended)
        observation = self._observer.observe(self.run.object_state, self.run.p_WP)
        return Outcome(observation, reward, terminated, truncated, progress, steps, ended, last, failures)

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that changes, for `set_state`: the station, images, steps, generators, and that of `on_reset`."""
        state = self.run.get_state() | self._observer.get_state() | {"steps": self._steps.copy()}
        state["generators"] = np.stack([generator_state(one) for one in self._random])
        if isinstance(self.on_reset, Resumable):
            state |= {f"{_RESET}{name}": values for name, values in self.on_reset.get_state().items()}
        return state

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Puts what `get_state` gave back, in worlds that were made alike; they go on bit by bit."""
        self.run.set_state(arrays)
        self._observer.set_state(arrays)
        self._steps = arrays["steps"].copy()
        for generator, state in zip(self._random, arrays["generators"], strict=True):
            set_generator_state(generator, state)
        if isinstance(self.on_reset, Resumable):
            names = [name for name in arrays if name.startswith(_RESET)]
            self.on_reset.set_state({name.removeprefix(_RESET): arrays[name] for name in names})
        self._progress = self._measure()

    def _advance(self, actions: np.ndarray) -> dict[int, str]:
        """One action; worlds whose physics fails are put back to where they were, and named."""
        failures: dict[int, str] = {}
        state, p_WP = self.run.object_state.copy(), self.run.p_WP.copy()
        try:
            self.run.advance(actions)
        except FAILURES as error:
            failures = dict.fromkeys(getattr(error, "worlds", ()), str(error))
            if not failures:
                raise
            middle = self._start.middle()
            for world in failures:
                self.run.place(middle, world)
            self.run.again()
            self.run.advance(actions)
        lost = np.flatnonzero(~np.isfinite(self.run.object_state).all(axis=1)).tolist()
        failures |= dict.fromkeys(lost, "the object's state is not finite")
        for world in failures:
            self.run.put(state[world], p_WP[world], world)
        return failures

    def _begin(self, worlds: np.ndarray, options: Sequence[dict[str, Any] | None] | None = None) -> None:
        """Begins an episode in some worlds (m,)."""
        for world in worlds.tolist():
            if self.on_reset is not None:
                cousin = self.on_reset(world)
                if cousin is not None:
                    self.run.become(cousin, world, colours=self._observer.needs_images)
            drawn = self._start.draw(self._random[world])
            self.run.place(chosen_place(drawn, options[world] if options else None), world)
        self._steps[worlds] = 0
        self._progress = self._measure()
        if self._observer.needs_images:
            # The port renders all worlds; at the start of an episode those that begin are enough.
            self._observer.begin(worlds, self.run.images_of(worlds))

    def _measure(self) -> Progress:
        return self.task.measure(self.run.object_state, self.run.p_WP)
