# SPDX-License-Identifier: MIT
"""The worlds of an environment: one step, one reset, for one world of any engine and for many worlds of a twin."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from pydrake.math import RigidTransform

from pinwm_drake.checkpoints import Resumable, generator_state, set_generator_state
from pinwm_drake.cousins.cousin import Cousin
from pinwm_drake.errors import ParameterError, require
from pinwm_drake.systems.envs.delay import Delay
from pinwm_drake.systems.envs.observation import Observation, Observer
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.envs.station_run import FAILURES, StationRun, most_parts
from pinwm_drake.systems.scenario.load import Scene, load_setup
from pinwm_drake.systems.scenario.start import Place, StartDistribution
from pinwm_drake.tasks.task import Progress
from pinwm_drake.tasks.waypoints import Waypoints

_DOMAIN = "domain."
_MIDWAY = 0.6  # share of the episodes that begin in a waypoint, where there are any
RESET_OPTIONS = ("place", "X_WO", "p_WP", "goal")
OnReset = Callable[[int], Cousin | None]
Spoil = Callable[[np.ndarray, np.random.Generator], np.ndarray]


@dataclass(frozen=True, eq=False)
class Advance:
    """Outcome of one action in W worlds.

    Attributes:
        reward: (W,) rewards of the task.
        terminated: (W,) bool, true with success, and where the pusher pressed harder than `Worlds.most_force`.
        truncated: (W,) bool, true at the time limit, or after a failure of the physics.
        progress: Progress at the end of the action.
        steps: (W,) int, actions of the episodes, this one included.
        failures: Reasons why the physics failed, or the pusher pressed too hard, by the world's index.
    """

    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    progress: Progress
    steps: np.ndarray
    failures: dict[int, str]

    @property
    def ended(self) -> np.ndarray:
        """Indices (m,) of the worlds whose episodes ended."""
        return np.flatnonzero(self.terminated | self.truncated)

    def info(self, world: int, engine: str) -> dict[str, Any]:
        """`info` of one world, as gymnasium has it."""
        found = {**progress_info(self.progress, world), "step": int(self.steps[world]), "engine": engine}
        return found | ({"failure": self.failures[world]} if world in self.failures else {})


class Worlds:
    """W worlds of one station, in which episodes begin and advance by actions; nothing begins by itself.

    World k draws its starts from a generator of its own, seeded with `seed + k` by the environments, so that its
    episodes do not depend on the other worlds. Engines other than the twin have one world.

    Args:
        scene: A setup, a scenario, the name or path of one, or the folder of a twin; see `load_setup`.
        engine: "twin", "hydroelastic" or "point"; None for that of the scenario.
        num_worlds: Number of worlds, W; 1 for engines other than the twin.
        options: Options of the environment; None for the defaults.
        domain: Called with a world's index before it begins an episode; gives the theta and colours of that episode, or
            None to leave them. Colours are not asked for where no images are seen.

    Attributes:
        setup: The scene, with the task.
        task: Goal, success and rewards.
        run: The station, and the Simulator that advances it.
        progress: Progress of the worlds now.
        max_steps: Number of actions after which an episode is truncated.
        observation_space, action_space: Spaces of one world.
        waypoints: States in which most episodes of a training begin, so that all of the way to the goal is met; none at
            first, and none within `usual_starts`.
        continued: Share of the episodes of a training that begin where the one before met its time limit, so that a
            policy learns to try again; 0 at first, and within `usual_starts`. An object that the pusher cannot reach
            begins anew.
        retries: Share of the other episodes of a training that begin as after a try that failed, with the pusher on any
            side of the object or over it: `StartDistribution.anywhere`; 0 at first, and within `usual_starts`.
        disturbance: Standard deviation of what is added to the object's velocities after an action, in shares of them;
            0 at first.
        light: Largest share of its colour that the darkest side of the object loses in the light of an episode; the
            whole object loses up to as much once more. 0 at first: the light that the twin was filmed in.
        acceleration: m/s^2, largest one of the pusher; infinite for none.
        most_force: N, largest mean force of a twin's pusher in an action; an episode with more ends there as failed.
            None at first, which is without a limit.
        spoil: Called with each new image (height, width, 4) uint8 RGBA and the generator of its world; gives the image
            that is seen instead. None at first.

    Raises:
        InputError: The scene, or one of its files, cannot be used.
        ParameterError: An option is none of those allowed.
    """

    def __init__(
        self,
        scene: Scene = "push_t",
        engine: str | None = "twin",
        num_worlds: int = 1,
        options: EnvOptions | None = None,
        *,
        domain: OnReset | None = None,
    ) -> None:
        require("num_envs", num_worlds, num_worlds >= 1, "1 or more")
        options = options or EnvOptions()
        self.setup = environment_setup(load_setup(scene), options, num_worlds=num_worlds)
        self.task, self.domain, self.num_worlds = self.setup.task, domain, num_worlds
        self.max_steps = self.task.max_steps if options.max_steps is None else int(options.max_steps)
        at_once = not any(options.latency) and not any(options.lag) and math.isinf(options.acceleration)
        parts = 1 if at_once else most_parts(self.setup)
        self.run = StationRun(self.setup, engine, options.max_translation, parts)
        self.engine = self.run.station.engine.name
        self._observer = Observer(self.setup, options.observation, options.frames, options.history)
        self.observation_space = self._observer.space
        self.action_space = spaces.Box(-1.0, 1.0, (self.task.action_size,), np.float32)
        self._start, self.waypoints, self.disturbance = StartDistribution(self.setup), Waypoints(), 0.0
        self.retries, self.continued, self._late = 0.0, 0.0, np.zeros(num_worlds, bool)
        self.most_force: float | None = None
        self.light = 0.0
        self.acceleration = options.acceleration
        horizon = self.setup.scenario.pusher.horizon
        limits = options.lag, options.acceleration, self.run.max_translation
        self._delay = Delay(options.latency, horizon, num_worlds, self.task, parts, *limits)
        if any(options.view):
            require("view", f"one with engine {self.engine!r}", self.run.world_model is not None, "with engine 'twin'")
            X_WC = self.setup.X_WC
            self.run.set_camera(RigidTransform(X_WC.rotation(), X_WC.translation() - np.array(options.view)))
        self.spoil: Spoil | None = None
        self._goal = np.zeros((num_worlds, self.task.goal_size))
        self._steps = np.zeros(num_worlds, int)
        self._random = [seeding.np_random(None)[0] for _ in range(num_worlds)]
        self._take_state()

    @property
    def goal(self) -> np.ndarray:
        """Goals (W, task.goal_size) of the present episodes."""
        return self._goal.copy()

    def set_generator(self, world: int, generator: np.random.Generator) -> None:
        """Set the generator that a world draws its starts from."""
        self._random[world] = generator

    def reset(
        self, seeds: Sequence[int | None] | None = None, options: Sequence[dict[str, Any] | None] | None = None
    ) -> Observation:
        """Begins an episode in every world, at time 0 of the simulation.

        Args:
            seeds: (W,) seeds of the worlds' generators; None goes on with a generator, or with all.
            options: (W,) any of {"place": Place, "X_WO": RigidTransform, "p_WP": (3,) m, world, "goal":
                (task.goal_size,)}: places of object and pusher, and the goal, instead of those that are drawn; None for
                the drawn ones.

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
        self._late[:] = False
        self.begin(np.arange(self.num_worlds), options)
        return self.observe()

    def begin(self, worlds: np.ndarray, options: Sequence[dict[str, Any] | None] | None = None) -> None:
        """Begins an episode in some worlds.

        Args:
            worlds: (m,) int, indices of the worlds.
            options: (W,) options as for `reset`.

        Raises:
            ParameterError: There is no such option.
        """
        asked: dict[int, np.ndarray] = {}
        for world in worlds.tolist():
            if self.domain is not None and (domain := self.domain(world)) is not None:
                self.run.set_domain(domain, world, colours=self._observer.needs_images)
            generator, given = self._random[world], options[world] if options else None
            if self.light and self._observer.needs_images:
                self.run.set_light(_drawn_light(generator, self.light), world)
            row = None
            if not given and self._late[world] and generator.random() < self.continued:
                self.run.set_world_state(self._object_state[world], self._p_WP[world], world)
            elif not given and len(self.waypoints) and generator.random() < _MIDWAY:
                row = generator.integers(len(self.waypoints))
                self.run.set_world_state(self.waypoints.object_state[row], self.waypoints.p_WP[row], world)
            else:
                again = not given and self.retries and generator.random() < self.retries
                drawn = self._start.anywhere(generator)[0] if again else self._start.draw(generator)
                self.run.place(_chosen_place(drawn, given), world)
            self._goal[world] = self._chosen_goal(self.task.draw_goal(generator), given)
            self._delay.begin(world, generator)
            if row is not None:
                asked[world] = self.waypoints.before(row, self.actions_before)
                self._delay.recall(world, asked[world][: self._delay.depth])
        self._steps[worlds] = 0
        self._late[worlds] = False
        self._take_state()
        self._observer.forget(self._object_state, self._p_WP, self._goal, worlds)
        for world, actions in asked.items():
            self._observer.recall(world, actions)
        if self._observer.needs_images:
            # The port renders all worlds; at the start of an episode those that begin are enough.
            images = self.run.images() if self.run.world_model is None else self.run.images_of(worlds)
            self._observer.begin(worlds, self._spoilt(images, worlds))

    @property
    def actions_before(self) -> int:
        """Number of past actions that are seen, or on which it may depend what the pushers do next."""
        return max(self._delay.depth, self._observer.history)

    def set_object_states(self, object_state: np.ndarray, p_WP: np.ndarray) -> None:
        """Put every one of the twin's worlds into a state, at the beginning of an episode; images are not taken.

        Args:
            object_state: (W, 13) q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world.
            p_WP: (W, 3) m, world: positions of the pushers.
        """
        self.run.set_world_state(object_state, p_WP)
        self._delay.rest()
        self._steps[:] = 0
        self._take_state()
        self._observer.forget(self._object_state, self._p_WP, self._goal, np.arange(self.num_worlds))

    def advance(self, actions: np.ndarray) -> Advance:
        """Goes on by one action in every world.

        A world whose physics finds no solution stays where it was, and its episode is truncated.

        Args:
            actions: (W, task.action_size) in [-1, 1], along the task's axes.
        """
        before = self.progress
        self._observer.remember(self._object_state, self._p_WP, self._goal, actions)
        self._steps += 1
        impulse = self.run.pusher_impulse
        failures = self._advance(self._delay(actions))
        if self.disturbance:
            self._disturb()
        progress, failed = self.progress, np.zeros(self.num_worlds, bool)
        failed[list(failures)] = True
        hard = self._too_hard(impulse) & ~failed
        reason = f"the pusher pressed with a mean force over {self.most_force} N"
        failures |= dict.fromkeys(np.flatnonzero(hard).tolist(), reason)
        progress = replace(progress, success=progress.success & ~hard)
        terminated = (progress.success | hard) & ~failed
        truncated = failed | ((self._steps >= self.max_steps) & ~terminated)
        self._late = truncated & ~failed & self._within_reach() if self.continued else np.zeros_like(failed)
        if self._observer.needs_images and not failed.all():
            self._observer.see(self._spoilt(self.run.images(), np.arange(self.num_worlds)))
        reward = self.task.rewards(before, progress)
        return Advance(reward, terminated, truncated, progress, self._steps.copy(), failures)

    def _within_reach(self) -> np.ndarray:
        """Flags (W,): the object's origin is where the pusher can be."""
        p_WO, pusher = self._object_state[:, 4:6], self.setup.scenario.pusher
        return np.asarray(((p_WO > pusher.low[:2]) & (p_WO < pusher.high[:2])).all(axis=1))

    def observe(self, worlds: np.ndarray | slice = np.s_[:]) -> Observation:
        """Observation of the worlds with indices (m,) int, or of a slice of them, in arrays of its own."""
        return self._observer.observe(self._object_state, self._p_WP, worlds, self._goal)

    def get_state(self) -> dict[str, np.ndarray]:
        """Arrays of everything that changes, for `set_state`: station, images, steps, generators, state of `domain`."""
        state = self.run.get_state() | self._observer.get_state() | self._delay.get_state()
        state |= {"steps": self._steps.copy(), "goal": self._goal.copy()}
        state["generators"] = np.stack([generator_state(one) for one in self._random])
        if isinstance(self.domain, Resumable):
            state |= {f"{_DOMAIN}{name}": values for name, values in self.domain.get_state().items()}
        return state

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `get_state`, in worlds that were made alike; they go on bit by bit."""
        self.run.set_state(arrays)
        self._observer.set_state(arrays)
        self._delay.set_state(arrays)
        self._steps, self._goal = arrays["steps"].copy(), arrays["goal"].copy()
        for generator, state in zip(self._random, arrays["generators"], strict=True):
            set_generator_state(generator, state)
        if isinstance(self.domain, Resumable):
            names = [name for name in arrays if name.startswith(_DOMAIN)]
            self.domain.set_state({name.removeprefix(_DOMAIN): arrays[name] for name in names})
        self._take_state()

    def _advance(self, actions: np.ndarray) -> dict[int, str]:
        """Simulate one action; worlds whose physics fails are put back, and returned with the reasons."""
        failures: dict[int, str] = {}
        last = self._object_state, self._p_WP
        try:
            self.run.advance(actions)
        except FAILURES as error:
            failures = dict.fromkeys(getattr(error, "worlds", ()), str(error))
            if not failures and self.num_worlds == 1:
                failures = {0: str(error)}
            if not failures:
                raise
            if self.num_worlds == 1:
                return self._stay(last, failures)
            middle = self._start.middle()
            for world in failures:
                self.run.place(middle, world)
            self.run.retry()
            self.run.advance(actions)
        lost = np.flatnonzero(~np.isfinite(self.run.object_state).all(axis=1)).tolist()
        failures |= dict.fromkeys(lost, "the object's state is not finite")
        if failures and self.num_worlds == 1:
            return self._stay(last, failures)
        for world in failures:
            self.run.set_world_state(last[0][world], last[1][world], world)
        self._take_state()
        return failures

    def _too_hard(self, before: np.ndarray | None) -> np.ndarray:
        """Flags (W,): the mean force in an action exceeded `most_force`; `before` are impulses (W,) N s before it."""
        after = self.run.pusher_impulse
        if self.most_force is None or before is None or after is None:
            return np.zeros(self.num_worlds, bool)
        return np.asarray(after - before > self.most_force * self.setup.scenario.pusher.horizon)

    def _spoilt(self, images: np.ndarray, worlds: np.ndarray) -> np.ndarray:
        if self.spoil is None:
            return images
        pairs = zip(images, worlds.tolist(), strict=True)
        return np.stack([self.spoil(image, self._random[world]) for image, world in pairs])

    def _disturb(self) -> None:
        object_state = self._object_state.copy()
        noise = np.array([generator.normal(0.0, self.disturbance, (2, 3)) for generator in self._random])
        velocities = object_state[:, 7:].reshape(-1, 2, 3)  # a view
        velocities += noise * np.linalg.norm(velocities, axis=2, keepdims=True)
        self.run.set_world_state(object_state, self._p_WP)
        self._take_state()

    def _stay(self, last: tuple[np.ndarray, np.ndarray], failures: dict[int, str]) -> dict[int, str]:
        """Leaves the only world in the state before an action that failed, (1, 13) and (1, 3) m; gives the failures."""
        if self.run.world_model is not None:  # a plant is not put back: its next episode begins with a restart
            self.run.set_world_state(last[0][0], last[1][0], 0)
            self.run.retry()
        self._take_state(*last)
        return failures

    def _take_state(self, object_state: np.ndarray | None = None, p_WP: np.ndarray | None = None) -> None:
        """Take the state of the station, or one given, (W, 13) and (W, 3), as that of the worlds."""
        self._object_state = self.run.object_state.copy() if object_state is None else object_state
        self._p_WP = self.run.p_WP.copy() if p_WP is None else p_WP
        self.progress = self.task.measure(*self.task.from_goal(self._object_state, self._p_WP, self._goal))

    def _chosen_goal(self, drawn: np.ndarray, options: dict[str, Any] | None) -> np.ndarray:
        goal = np.asarray((options or {}).get("goal", drawn), float)
        if goal.shape != drawn.shape or not np.isfinite(goal).all():
            raise ParameterError(f"goal: got {goal.tolist()}; allowed: {len(drawn)} finite numbers")
        return goal


def progress_info(progress: Progress, world: int) -> dict[str, Any]:
    """`info` of one world's progress: `distance` [m], `angle` [rad] and `success`."""
    return {
        "distance": float(progress.distance[world]),
        "angle": float(progress.angle[world]),
        "success": bool(progress.success[world]),
    }


def _drawn_light(generator: np.random.Generator, most: float) -> np.ndarray:
    """Random light (4,): the darkest side loses a share of its colour, up to `most`, and the whole object another."""
    whole, side = 1.0 - most * generator.random(2)
    way = generator.standard_normal(3)
    return whole * np.array([0.5 * (1.0 + side), *(0.5 * (1.0 - side) * way / np.linalg.norm(way))])


def _chosen_place(drawn: Place, options: dict[str, Any] | None) -> Place:
    options = options or {}
    for name in options:
        require("options", repr(name), name in RESET_OPTIONS, ", ".join(RESET_OPTIONS))
    place = options.get("place", drawn)
    X_WO, p_WP = options.get("X_WO", place.X_WO), np.asarray(options.get("p_WP", place.p_WP), float)
    require("X_WO", f"a {type(X_WO).__name__}", isinstance(X_WO, RigidTransform), "a RigidTransform")
    require("p_WP", p_WP.tolist(), p_WP.shape == (3,) and np.isfinite(p_WP).all(), "three finite numbers, m")
    return Place(X_WO, p_WP)
