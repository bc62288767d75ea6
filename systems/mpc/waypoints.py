# SPDX-License-Identifier: MIT
"""Waypoints of a planner's plans, for trainings of tasks that chance hardly ever does."""

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from math import nan as NAN
from pathlib import Path

import numpy as np

from pinwm_drake.checkpoints import read_arrays
from pinwm_drake.errors import require
from pinwm_drake.learning.progress import Report, Step, silent
from pinwm_drake.pace import Pace
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds
from pinwm_drake.systems.envs.worlds import Worlds
from pinwm_drake.systems.mpc.sampling import SamplingMpc, SamplingOptions, carried_out
from pinwm_drake.systems.scenario.start import Place, StartDistribution
from pinwm_drake.tasks.waypoints import WAYPOINTS_FILE, Waypoints

STAGE = "waypoints"
_WORTH = 0.5  # of a success that counts
_SLIP = 0.002  # m, standard deviation of the pusher's place at the start of a replay
_ELITE, _MOMENTUM, _LEAST = 0.25, 0.2, 0.03  # of the rounds that make a plan more robust


@dataclass(frozen=True)
class WaypointOptions:
    """Settings of the search for waypoints.

    Attributes:
        attempts: Largest number of starts from which the task is planned.
        share: Share of a plan's replays with success from which no more starts are tried.
        replays: Number of a plan's replays, in units of the worlds.
        noise: Standard deviation of the noise on the actions of a replay, in units of an action.
        rounds: Number of the rounds that make the best plan more robust.
        plans: Number of the changed plans of a round.
        starts: Number of the starts from which each of these is carried out, at most that of the worlds.
        change: Standard deviation of the first changes, in units of an action.
        planner: Options of the planner.

    Raises:
        ParameterError: A number is out of range.
    """

    attempts: int = 20
    share: float = 0.2
    replays: int = 4
    noise: float = 0.05
    rounds: int = 15
    plans: int = 32
    starts: int = 16
    change: float = 0.08
    planner: SamplingOptions = field(default_factory=lambda: SamplingOptions(horizon=12, first_iterations=15))

    def __post_init__(self) -> None:
        for name, least in (("attempts", 1), ("replays", 1), ("rounds", 0), ("plans", 2), ("starts", 1)):
            require(name, getattr(self, name), getattr(self, name) >= least, f"{least} or more")
        for name in ("share", "noise", "change"):
            require(name, getattr(self, name), 0.0 <= getattr(self, name) <= 1.0, "0 to 1")


def find_waypoints(
    worlds: TrainingWorlds,
    folder: Path,
    options: WaypointOptions | None = None,
    *,
    seed: int = 0,
    resume: bool = False,
    report: Report = silent,
) -> Waypoints:
    """Waypoints of the most robust plan from the starts of a scene, in `folder` as well.

    A plan that works in the twin may hang on a hair there. So each is carried out again in the worlds of the training,
    from other starts and with noise on the actions, and the plan that does the task most often is changed by
    cross-entropy to do it more often still. What is kept are the states of its replays that did the task, and what it
    does there.

    Sources: starts from the states of demonstrations as in Salimans and Chen, "Learning Montezuma's Revenge from a
        single demonstration" (2018), with all distances from the goal at once; noise on what is shown, not on what is
        learned from it, as in Laskey et al., "DART" (CoRL 2017).

    Args:
        worlds: The worlds of a training.
        folder: Existing folder; of an interrupted search it has what was found until then.
        options: Settings; None for the defaults.
        seed: Seed of starts, plans and replays, 0 or more.
        resume: Flag: the search goes on from the file in the folder, where there is one.
        report: Called with the progress: steps are states that were found, success is that of the best plan's replays.

    Returns:
        The waypoints; none where no plan was found.

    Raises:
        InputError: The folder's file cannot be read or written, or is of another search.
    """
    options = options or WaypointOptions()
    about = {**worlds.about, "search": asdict(options), "seed": seed}
    search = _Search(worlds, options, seed)
    if resume:
        search.restore(folder, about)
    pace, begun = Pace(), time.monotonic()
    while search.goes_on():
        best = search.best
        best.waypoints.write(folder, about, share=np.array(best.share), actions=best.actions, **search.get_state())
        _, left = pace(search.done, search.steps)
        seconds = time.monotonic() - begun
        report(Step(STAGE, search.done, len(best.waypoints), best.share, NAN, NAN, best.share, seconds, left=left))
    return search.best.waypoints


@dataclass(frozen=True, eq=False)
class _Plan:
    """Waypoints of those replays of a plan that did the task, their share of all its replays, and its actions.

    The actions (horizon, n) are told from a start with the pusher along x from the object.
    """

    waypoints: Waypoints
    share: float
    actions: np.ndarray


class _Search:
    """Plans and their replays, attempt after attempt, then rounds around the best one; each has a seed of its own."""

    def __init__(self, worlds: TrainingWorlds, options: WaypointOptions, seed: int) -> None:
        self._options, self._seed, self._begin = options, seed, worlds.begin
        self._replays: Worlds = worlds.task_worlds("state").worlds
        setup = self._replays.setup
        self._planner = SamplingMpc(setup, worlds.setup.task, self._replays.run.max_translation, options.planner)
        self._start = StartDistribution(setup)
        shape = options.planner.horizon, setup.task.action_size
        self.best = _Plan(Waypoints(), 0.0, np.zeros(shape))
        self.attempts, self.rounds = 0, 0
        self._mean, self._deviation = np.zeros(shape), np.full(shape, options.change)

    @property
    def steps(self) -> int:
        return self.attempts + self.rounds

    @property
    def done(self) -> float:
        if self._tries():
            return self.attempts / (self._options.attempts + self._options.rounds)
        return 1.0 - (self._options.rounds - self.rounds) / (self._options.attempts + self._options.rounds)

    def goes_on(self) -> bool:
        if self._tries():
            self._attempt()
        elif self.best.share and self.rounds < self._options.rounds:
            self._strengthen()
        else:
            return False
        return True

    def get_state(self) -> dict[str, np.ndarray]:
        counts = {"attempts": np.array(self.attempts), "rounds": np.array(self.rounds)}
        return counts | {"mean": self._mean, "deviation": self._deviation}

    def restore(self, folder: Path, about: Mapping[str, object]) -> None:
        names = [one.name for one in fields(Waypoints)]
        arrays = read_arrays(folder / WAYPOINTS_FILE, about, STAGE, ["share", "actions", *self.get_state(), *names])
        if arrays is None:
            return
        found = Waypoints(*(arrays[name] for name in names))
        self.best = _Plan(found, float(arrays["share"]), arrays["actions"])
        self.attempts, self.rounds = int(arrays["attempts"]), int(arrays["rounds"])
        self._mean, self._deviation = arrays["mean"], arrays["deviation"]

    def _tries(self) -> bool:
        return self.attempts < self._options.attempts and self.best.share < self._options.share

    def _attempt(self) -> None:
        number, self.attempts = self.attempts, self.attempts + 1
        generator = np.random.default_rng([self._seed, number])
        self._planner.reseed([self._seed, number, 1])
        place = self._start.draw(generator)
        turn = self._planner.turn(place.object_state, place.p_WP)
        # Two of three are like the best one so far, from another start: the more robust one of them is kept again.
        like = self.best.actions @ turn.T if self.best.share and number % 3 else None
        plan = self._planner.plan(place.object_state, place.p_WP, like=like)
        if not plan.success:
            return
        self._seed_worlds(generator)
        self._keep(self._bounded(plan.actions) @ turn, generator)

    def _strengthen(self) -> None:
        options, W = self._options, self._replays.num_worlds
        if self.rounds == 0:
            self._mean = self.best.actions
        generator = np.random.default_rng([self._seed, options.attempts + self.rounds])
        self._seed_worlds(generator)
        starts = min(options.starts, W)
        at, noise = self._draw(starts, generator), self._noise(starts, generator)
        plans = self._mean + self._deviation * generator.normal(size=(options.plans, *self._mean.shape))
        plans = np.array([self._bounded(plan) for plan in plans])
        worth = []
        for some in np.array_split(plans, -(-len(plans) // (W // starts))):
            # Worlds that are left over do what others do.
            which, start = np.arange(W) // starts % len(some), np.arange(W) % starts
            wanted = some[which] @ self._place([at[k] for k in start]).swapaxes(1, 2)
            total = np.zeros(W)
            for going, out in carried_out(self._replays, np.clip(wanted + noise[start], -1.0, 1.0)):
                total += np.where(going, out.reward, 0.0)
            worth += [total[which == k].mean() for k in range(len(some))]
        elites = plans[np.argsort(-np.array(worth), kind="stable")[: max(round(_ELITE * len(plans)), 1)]]
        self._mean = _MOMENTUM * self._mean + (1.0 - _MOMENTUM) * elites.mean(0)
        self._deviation = np.maximum(_MOMENTUM * self._deviation + (1.0 - _MOMENTUM) * elites.std(0), _LEAST)
        self.rounds += 1
        if self.rounds == options.rounds:
            self._keep(self._mean, generator)

    def _keep(self, actions: np.ndarray, generator: np.random.Generator) -> None:
        replays = [self._replay(actions, generator) for _ in range(self._options.replays)]
        share = float(np.mean([share for _, share in replays]))
        if share > self.best.share:
            columns = [[getattr(found, column.name) for found, _ in replays] for column in fields(Waypoints)]
            self.best = _Plan(Waypoints(*map(np.concatenate, columns)), share, actions)

    def _seed_worlds(self, generator: np.random.Generator) -> None:
        self._begin(int(generator.integers(1 << 31)))
        for world, own in enumerate(generator.spawn(self._replays.num_worlds)):
            self._replays.set_generator(world, own)

    def _bounded(self, actions: np.ndarray) -> np.ndarray:
        return np.asarray(self._replays.task.translation(actions, 1.0)[:, self._replays.task.axis_indices])

    def _draw(self, number: int, generator: np.random.Generator) -> list[Place]:
        places = [self._start.draw(generator) for _ in range(number)]
        slips = generator.normal(0.0, _SLIP, (number, 3))
        return [Place(place.X_WO, place.p_WP + slip) for place, slip in zip(places, slips, strict=True)]

    def _noise(self, number: int, generator: np.random.Generator) -> np.ndarray:
        return np.asarray(generator.normal(0.0, self._options.noise, (number, *self._mean.shape)))

    def _place(self, places: list[Place]) -> np.ndarray:
        """Begins episodes of the training from places (W); gives the turns (W, n, n) of a plan's actions there."""
        self._replays.begin(np.arange(len(places)))  # for the domains
        self._replays.set_object_states(
            np.array([place.object_state for place in places]), np.array([place.p_WP for place in places])
        )
        return np.array([self._planner.turn(place.object_state, place.p_WP) for place in places])

    def _replay(self, actions: np.ndarray, generator: np.random.Generator) -> tuple[Waypoints, float]:
        """Return the waypoints of those replays of a plan that did the task, and their share."""
        worlds, W = self._replays, self._replays.num_worlds
        wanted = actions @ self._place(self._draw(W, generator)).swapaxes(1, 2)
        noise = self._noise(W, generator)
        seen, went, success = [_states(worlds)], [], np.zeros(W, bool)
        for going, out in carried_out(worlds, np.clip(wanted + noise, -1.0, 1.0)):
            seen.append(_states(worlds))
            went.append(going)
            success |= going & out.terminated & (worlds.task.worth(out.progress) > _WORTH)
        kept = np.array(went) & success  # (T, W)
        object_state, p_WP = (np.array(column)[:-1][kept] for column in zip(*seen, strict=True))
        found = Waypoints(object_state, p_WP, wanted.swapaxes(0, 1)[: len(kept)][kept])
        return found, float(success.mean())


def _states(worlds: Worlds) -> tuple[np.ndarray, np.ndarray]:
    return worlds.run.object_state.copy(), worlds.run.p_WP.copy()
