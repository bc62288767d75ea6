# SPDX-License-Identifier: MIT
"""Search for plans of tasks that chance hardly ever does, whose states are waypoints of a training."""

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from math import nan as NAN
from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.checkpoints import check_arrays, read_arrays
from pinwm_drake.errors import require
from pinwm_drake.learning.progress import Report, Step, silent
from pinwm_drake.pace import Pace
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds
from pinwm_drake.systems.envs.worlds import Worlds
from pinwm_drake.systems.mpc.approach import way_past
from pinwm_drake.systems.mpc.sampling import carried_out, heading_turn
from pinwm_drake.systems.mpc.strokes import Strokes
from pinwm_drake.systems.scenario.start import Place, StartDistribution
from pinwm_drake.tasks.waypoints import WAYPOINTS_FILE, Waypoints

STAGE = "waypoints"
_WORTH = 0.5  # of a success that counts
_ALIKE = 0.05  # mean difference of two plans' actions, up to which they count as one
_SLIP = 0.002  # m, standard deviation of the pusher's place at the start of a replay
_RESTS, _AFTER = 0.5, 0.7  # rad/s and m/s together, of what comes to rest; share of further tries after failures
_AGAIN, _WAY = 8, 10  # replays of further tries, for each other; the most actions of a way past the object
# Shares of the noise with which a plan is replayed until enough replays do the task. Such a share counts as much less.
_WEIGHTS, _ENOUGH = (1.0, 0.5, 0.25), 0.1
_ELITE, _MOMENTUM, _LEAST = 0.25, 0.2, 0.03  # of the rounds that make a plan more robust


@dataclass(frozen=True)
class WaypointOptions:
    """Settings of the search for waypoints.

    Attributes:
        strokes: Number of strokes that are tried, each in as many domains and starts as the first of `sieves` says.
        sieves: Pairs of numbers: starts from which plans are carried out, and plans that are kept, the best ones.
        attempts: Number of the plans kept at last that are made more robust; they differ from each other.
        replays: Number of a plan's replays, in units of the worlds.
        noise: Standard deviation of the noise on the actions of a replay, in units of an action. A half and a quarter
            of it are tried where fewer than a tenth of a plan's replays do the task, and count a half and a quarter.
        rounds: Number of the rounds that make a plan more robust.
        plans: Number of the changed plans of a round.
        starts: Number of the starts from which each of these is carried out, at most that of the worlds.
        change: Standard deviation of the first changes, in units of an action.
        horizon: Number of actions of a plan.

    Raises:
        ParameterError: A number is out of range.
    """

    strokes: int = 8192
    sieves: tuple[tuple[int, int], ...] = ((2, 256), (8, 32), (32, 32))
    attempts: int = 3
    replays: int = 4
    noise: float = 0.05
    rounds: int = 10
    plans: int = 32
    starts: int = 16
    change: float = 0.08
    horizon: int = 9

    def __post_init__(self) -> None:
        least = {"strokes": 1, "attempts": 1, "replays": 1, "rounds": 0, "plans": 2, "starts": 1, "horizon": 1}
        for name, number in least.items():
            require(name, getattr(self, name), getattr(self, name) >= number, f"{number} or more")
        whole = all(starts >= 1 and kept >= 1 for starts, kept in self.sieves)
        require("sieves", self.sieves, bool(self.sieves) and whole, "pairs of numbers, 1 or more")
        for name in ("noise", "change"):
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

    Random strokes are carried out in the worlds of the training. Sieves keep those with the largest mean reward, from
    more and more starts. A few that differ are made more robust by cross-entropy, with noise on their actions. The plan
    with the largest share of replays that do the task stays: states of these replays, and what it does there. More
    replays are further tries, which begin within replays that failed, or anywhere. The pusher first goes past the
    object or over it, to where episodes begin.

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
    settings = asdict(options) | {"sieves": [list(sieve) for sieve in options.sieves]}
    about = {**worlds.about, "search": settings, "seed": seed}
    search = _Search(worlds, options, seed)
    if resume:
        search.restore(folder, about)
    pace, begun = Pace(), time.monotonic()
    while search.goes_on():
        best, done = search.best, search.done_steps / search.steps
        best.waypoints.write(folder, about, share=np.array(best.share), actions=best.actions, **search.get_state())
        _, left = pace(done, search.steps)
        seconds = time.monotonic() - begun
        report(Step(STAGE, done, len(best.waypoints), best.share, NAN, NAN, best.share, seconds, left=left))
    return search.best.waypoints


@dataclass(frozen=True, eq=False)
class _Plan:
    """Waypoints of those replays of a plan that did the task, their share of all its replays, and its actions.

    With a part of the noise the share counts that part; see `WaypointOptions.noise`.
    The actions (horizon, n) are told from a start with the pusher along x from the object.
    """

    waypoints: Waypoints
    share: float
    actions: np.ndarray


@dataclass(frozen=True, eq=False)
class _Try:
    """State (13,) and pusher (3,) m, world, of a further try, the pose in which the object rests, and its start."""

    object_state: np.ndarray
    p_WP: np.ndarray
    X_WO: RigidTransform
    begun: np.ndarray


class _Search:
    """Strokes and sieves, then rounds around each of the best plans; each step has a seed of its own."""

    def __init__(self, worlds: TrainingWorlds, options: WaypointOptions, seed: int) -> None:
        self._options, self._seed, self._begin = options, seed, worlds.begin
        self._replays: Worlds = worlds.task_worlds("state").worlds
        self._start = StartDistribution(self._replays.setup)
        task = worlds.setup.task
        allowed = "one with axes x, y and z, and a heading in its recipe"
        require("waypoints", f"of the task {task.name!r}", Strokes.apply(self._replays), allowed)
        shape = options.horizon, task.action_size
        self.best = _Plan(Waypoints(), 0.0, np.zeros(shape))
        self.done_steps, self._each = 0, max(options.rounds, 1)  # steps of an attempt
        self._plans, self._mean = np.zeros((options.attempts, *shape)), np.zeros(shape)
        self._deviation = np.full(shape, options.change)

    @property
    def steps(self) -> int:
        return 1 + self._options.attempts * self._each

    def goes_on(self) -> bool:
        if self.done_steps == self.steps:
            return False
        generator = np.random.default_rng([self._seed, self.done_steps])
        if self.done_steps == 0:
            self._plans = self._sieved(generator)
        else:
            attempt, number = divmod(self.done_steps - 1, self._each)
            if number == 0:
                self._mean = self._plans[attempt]
                self._deviation = np.full(self._mean.shape, self._options.change)
            if self._options.rounds:
                self._strengthen(generator)
            if number + 1 == self._each:
                self._keep(self._mean, generator)
        self.done_steps += 1
        return True

    def get_state(self) -> dict[str, np.ndarray]:
        counts = {"steps": np.array(self.done_steps), "plans": self._plans}
        return counts | {"mean": self._mean, "deviation": self._deviation}

    def restore(self, folder: Path, about: Mapping[str, object]) -> None:
        path = folder / WAYPOINTS_FILE
        arrays = read_arrays(path, about, STAGE, [one.name for one in fields(Waypoints)])
        if arrays is None:
            return
        wanted = self.get_state() | {"share": np.array(0.0), "actions": self._mean}
        shapes = {name: ("iu" if array.dtype.kind == "i" else "f", array.shape) for name, array in wanted.items()}
        check_arrays(path, arrays, shapes, STAGE)
        found = Waypoints.of_arrays(path, arrays)
        self.best = _Plan(found, float(arrays["share"]), arrays["actions"])
        self.done_steps, self._plans = int(arrays["steps"]), arrays["plans"]
        self._mean, self._deviation = arrays["mean"], arrays["deviation"]

    def _sieved(self, generator: np.random.Generator) -> np.ndarray:
        """Return strokes (attempts, horizon, n) that do the task from many starts, and differ; the best one first."""
        options, middle = self._options, self._start.middle()
        strokes = Strokes(self._replays, options.horizon)
        plans = strokes.draw(generator, options.strokes, middle.object_state, middle.p_WP)
        for starts, kept in options.sieves:
            worth = self._worth(plans, starts, 0.0, generator)
            plans = plans[np.argsort(-worth, kind="stable")[:kept]]
        chosen = [plans[0]]
        for plan in plans[1:]:
            if all(np.abs(plan - other).mean() > _ALIKE for other in chosen):
                chosen.append(plan)
        return np.array((chosen * options.attempts)[: options.attempts])

    def _strengthen(self, generator: np.random.Generator) -> None:
        options = self._options
        plans = self._mean + self._deviation * generator.normal(size=(options.plans, *self._mean.shape))
        plans = np.array([self._mean, *(self._bounded(plan) for plan in plans[1:])])
        worth = self._worth(plans, options.starts, options.noise, generator)
        elites = plans[np.argsort(-worth, kind="stable")[: max(round(_ELITE * len(plans)), 1)]]
        self._mean = _MOMENTUM * self._mean + (1.0 - _MOMENTUM) * elites.mean(0)
        self._deviation = np.maximum(_MOMENTUM * self._deviation + (1.0 - _MOMENTUM) * elites.std(0), _LEAST)

    def _worth(self, plans: np.ndarray, starts: int, noise: float, generator: np.random.Generator) -> np.ndarray:
        """Mean returns (P,) of plans (P, horizon, n) from the same starts, in the same domains, with the same noise."""
        W, worth = self._replays.num_worlds, []
        starts = min(starts, W)
        self._seed_worlds(generator, starts)
        at, noises = self._draw(starts, generator), self._noise(starts, noise, generator)
        start, domain = np.arange(W) % starts, self._replays.domain
        domains = None if domain is None else [domain(world) for world in range(starts)]
        if domains is not None:
            self._replays.domain = lambda world: domains[world % starts]
        self._replays.begin(np.arange(W))
        self._replays.domain = domain
        for some in np.array_split(plans, -(-len(plans) // (W // starts))):
            # Worlds that are left over do what others do.
            which = np.arange(W) // starts % len(some)
            wanted = some[which] @ self._place([at[k] for k in start]).swapaxes(1, 2)
            total = np.zeros(W)
            for going, out in carried_out(self._replays, np.clip(wanted + noises[start], -1.0, 1.0)):
                total += np.where(going, out.reward, 0.0)
                failed = going & out.terminated & ~out.progress.success  # it pressed too hard, and has turned nothing
                total[failed] = np.minimum(total[failed], 0.0)
            worth += [total[which == k].mean() for k in range(len(some))]
        return np.array(worth)

    def _keep(self, actions: np.ndarray, generator: np.random.Generator) -> None:
        for weight in _WEIGHTS:
            noise = weight * self._options.noise
            self._seed_worlds(generator, self._replays.num_worlds)
            replays = [self._replay(actions, noise, generator) for _ in range(self._options.replays)]
            share = weight * float(np.mean([share for _, share in replays]))
            if share >= _ENOUGH * weight:
                break
        if share > self.best.share:
            number = _AGAIN * self._options.replays
            again = [self._replay(actions, noise, generator, again=True) for _ in range(number)]
            columns = [[getattr(one, column.name) for one, _ in [*replays, *again]] for column in fields(Waypoints)]
            self.best = _Plan(Waypoints(*map(np.concatenate, columns)), share, actions)

    def _seed_worlds(self, generator: np.random.Generator, starts: int) -> None:
        """Draws domains; worlds of the same start, which come round after so many, get the same latency and noise."""
        self._begin(int(generator.integers(1 << 31)))
        seeds = generator.integers(1 << 31, size=starts)
        for world in range(self._replays.num_worlds):
            self._replays.set_generator(world, np.random.default_rng(int(seeds[world % starts])))

    def _bounded(self, actions: np.ndarray) -> np.ndarray:
        return np.asarray(self._replays.task.translation(actions, 1.0)[:, self._replays.task.axis_indices])

    def _draw(self, number: int, generator: np.random.Generator) -> list[Place]:
        places = [self._start.draw(generator) for _ in range(number)]
        slips = generator.normal(0.0, _SLIP, (number, 3))
        return [Place(place.X_WO, place.p_WP + slip) for place, slip in zip(places, slips, strict=True)]

    def _noise(self, number: int, noise: float, generator: np.random.Generator) -> np.ndarray:
        return np.asarray(generator.normal(0.0, noise, (number, *self._mean.shape)))

    def _place(self, places: list[Place]) -> np.ndarray:
        """Put the worlds into places (W); gives the turns (W, n, n) of a plan's actions there."""
        self._replays.set_object_states(
            np.array([place.object_state for place in places]), np.array([place.p_WP for place in places])
        )
        return np.array([heading_turn(self._replays.task, place.object_state, place.p_WP) for place in places])

    def _replay(
        self, actions: np.ndarray, level: float, generator: np.random.Generator, *, again: bool = False
    ) -> tuple[Waypoints, float]:
        """Return the waypoints of those replays of a plan that did the task, and their share."""
        worlds, W = self._replays, self._replays.num_worlds
        worlds.begin(np.arange(W))  # for the domains
        begun = self._again if again else self._once
        wanted, noise = begun(actions, level, generator)
        seen, went, success = [_states(worlds)], [], np.zeros(W, bool)
        asked = np.clip(wanted + noise, -1.0, 1.0)
        for going, out in carried_out(worlds, asked):
            seen.append(_states(worlds))
            went.append(going)
            success |= going & out.progress.success & (worlds.task.worth(out.progress) > _WORTH)
        kept = np.array(went) & success  # (T, W)
        object_state, p_WP = (np.array(column)[:-1][kept] for column in zip(*seen, strict=True))
        depth, (_, horizon, n) = worlds.actions_before, asked.shape
        bounded = self._bounded(asked.reshape(-1, n)).reshape(asked.shape)
        earlier = np.concatenate([np.zeros((W, depth, n)), bounded], axis=1)
        past = np.stack([earlier[:, k : k + depth][:, ::-1] for k in range(horizon)])  # (T, W, depth, n)
        found = Waypoints(object_state, p_WP, wanted.swapaxes(0, 1)[: len(kept)][kept], past[: len(kept)][kept])
        return found, float(success.mean())

    def _once(self, actions: np.ndarray, level: float, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Put the worlds at starts; gives a plan's actions there and the noise on them, (W, horizon, n) each."""
        W = self._replays.num_worlds
        wanted = actions @ self._place(self._draw(W, generator)).swapaxes(1, 2)
        return wanted, self._noise(W, level, generator)

    def _again(
        self, actions: np.ndarray, level: float, generator: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Put the worlds into further tries; gives ways to the starts, plans after them, and noise on these."""
        worlds, (horizon, n) = self._replays, actions.shape
        W, longest = worlds.num_worlds, worlds.run.max_translation
        drawn = [self._start.anywhere(generator) for _ in range(W)]
        tries = [_Try(place.object_state, place.p_WP, place.X_WO, begun) for place, begun in drawn]
        for world, found in self._failed(actions, level, generator).items():
            tries[world] = found
        worlds.set_object_states(np.array([one.object_state for one in tries]), np.array([one.p_WP for one in tries]))
        wanted, noise = np.zeros((2, W, _WAY + horizon, n))
        noises = self._noise(W, level, generator)
        for world, one in enumerate(tries):
            points = way_past(one.X_WO.translation(), one.p_WP, one.begun, self._start.clear_of(one.X_WO), longest)
            steps = np.diff(points, axis=0)[:_WAY] / longest
            plan = np.s_[world, len(steps) : len(steps) + horizon]
            wanted[world, : len(steps)] = steps
            turn = heading_turn(worlds.task, np.array([1.0, 0.0, 0.0, 0.0, *one.X_WO.translation()]), one.begun)
            wanted[plan] = actions @ turn.T
            noise[plan] = noises[world]
        return wanted, noise

    def _failed(self, actions: np.ndarray, level: float, generator: np.random.Generator) -> "dict[int, _Try]":
        """Return further tries by the world: states within replays that failed, and where the objects came to rest."""
        worlds = self._replays
        wanted, noise = self._once(actions, level, generator)
        seen, ended = [_states(worlds)], np.zeros(worlds.num_worlds, bool)
        for going, out in carried_out(worlds, np.clip(wanted + noise, -1.0, 1.0)):
            seen.append(_states(worlds))
            ended |= ~going | out.terminated
        last, _ = seen[-1]
        rest = ~ended & (np.linalg.norm(last[:, 7:], axis=1) < _RESTS)
        tries = {}
        for world in np.flatnonzero(rest).tolist():
            q, p = np.split(last[world, :7], [4])
            X_WO = RigidTransform(RotationMatrix(Quaternion(wxyz=q / np.linalg.norm(q))), p)
            begun = self._start.beside(X_WO)
            if begun is not None and generator.uniform() < _AFTER:
                object_state, p_WP = seen[int(generator.integers(len(seen) // 2, len(seen)))]
                tries[world] = _Try(object_state[world], p_WP[world], X_WO, begun)
        return tries


def _states(worlds: Worlds) -> tuple[np.ndarray, np.ndarray]:
    return worlds.run.object_state.copy(), worlds.run.p_WP.copy()
