"""Waypoints of a planner's plans, for trainings of tasks that chance hardly ever does."""

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from math import nan as NAN
from pathlib import Path

import numpy as np

from pinwm_drake.checkpoints import read_arrays
from pinwm_drake.errors import require
from pinwm_drake.learning.progress import Pace, Report, Step, silent
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds
from pinwm_drake.systems.envs.worlds import Worlds
from pinwm_drake.systems.mpc.sampling import ActionPlan, SamplingMpc, SamplingOptions, carried_out
from pinwm_drake.systems.scenario.start import Place, StartDistribution
from pinwm_drake.tasks.waypoints import WAYPOINTS_FILE, Waypoints

STAGE = "waypoints"
_WORTH = 0.5  # of a success that counts
_SLIP = 0.002  # m, standard deviation of the pusher's place at the start of a replay


@dataclass(frozen=True)
class WaypointOptions:
    """Settings of the search for waypoints.

    Attributes:
        attempts: Largest number of starts from which the task is planned.
        plans: Number of plans, the most robust ones, whose replays are kept.
        share: Share of a plan's replays with success from which it counts as robust; the search ends with `plans` of
            them.
        noise: Standard deviation of the noise on the actions of a replay, in units of an action.
        planner: Options of the planner.

    Raises:
        ParameterError: A number is out of range.
    """

    attempts: int = 30
    plans: int = 2
    share: float = 0.35
    noise: float = 0.05
    planner: SamplingOptions = field(default_factory=lambda: SamplingOptions(horizon=12, first_iterations=15))

    def __post_init__(self) -> None:
        """Checks the numbers."""
        for name in ("attempts", "plans"):
            require(name, getattr(self, name), getattr(self, name) >= 1, "1 or more")
        for name in ("share", "noise"):
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
    """Waypoints of the most robust plans from the starts of a scene, in `folder` as well.

    A plan that works in the twin may hang on a hair there. So each is carried out again in the domains of the training,
    with noise on the actions; what is kept are the states of such replays that did the task, of the plans with most of
    them. An episode that begins in one of the last of these states mostly succeeds, one of the first hardly ever.

    Source: starts from the states of demonstrations as in Salimans and Chen, "Learning Montezuma's Revenge from a
        single demonstration" (2018), with all distances from the goal at once.

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
    done, pace, begun = search.restore(folder, about) if resume else 0, Pace(), time.monotonic()
    while done < options.attempts and not search.robust:
        search.attempt(done)
        done += 1
        found, share = search.found(), done / options.attempts
        found.write(folder, about, attempts=np.array(done), **search.arrays())
        _, left = pace(share, done)
        seconds = time.monotonic() - begun
        report(Step(STAGE, share, len(found), search.best, NAN, NAN, search.best, seconds, left=left))
    return search.found()


@dataclass(frozen=True, eq=False)
class _Plan:
    """States of those replays of a plan that did the task, their share of all its replays, and its actions.

    The actions (horizon, n) are told from a start with the pusher along x from the object.
    """

    waypoints: Waypoints
    share: float
    actions: np.ndarray


class _Search:
    """Plans and their replays, of one attempt after another; each draws from a seed of its own."""

    def __init__(self, worlds: TrainingWorlds, options: WaypointOptions, seed: int) -> None:
        self._options, self._seed, self._begin = options, seed, worlds.begin
        self._replays: Worlds = worlds.worlds("state").worlds
        setup = self._replays.setup
        self._planner = SamplingMpc(setup, worlds.setup.task, self._replays.run.max_translation, options.planner)
        self._start = StartDistribution(setup)
        self._plans: list[_Plan] = []  # the most robust one first

    @property
    def best(self) -> float:
        """Share of the replays with success of the most robust plan; 0 without one."""
        return self._plans[0].share if self._plans else 0.0

    @property
    def robust(self) -> bool:
        """Flag: there are as many robust plans as are wanted."""
        return sum(plan.share >= self._options.share for plan in self._plans) >= self._options.plans

    def found(self) -> Waypoints:
        """All states that are kept."""
        known = [plan.waypoints for plan in self._plans] or [Waypoints()]
        return Waypoints(np.concatenate([one.object_state for one in known]), np.concatenate([o.p_WP for o in known]))

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays that `restore` needs beside the states: number of states of each plan, its share and actions."""
        plans = self._plans
        return {
            "sizes": np.array([len(plan.waypoints) for plan in plans], int),
            "shares": np.array([plan.share for plan in plans]),
            "actions": np.array([plan.actions for plan in plans]),
        }

    def restore(self, folder: Path, about: Mapping[str, object]) -> int:
        """Takes over what an earlier search found; gives the number of its attempts."""
        names = ("sizes", "shares", "actions")
        arrays = read_arrays(folder / WAYPOINTS_FILE, about, STAGE, ["attempts", "object_state", "p_WP", *names])
        if arrays is None:
            return 0
        known, ends = Waypoints(arrays["object_state"], arrays["p_WP"]), np.cumsum(arrays["sizes"])
        for end, size, share, actions in zip(ends, *(arrays[name] for name in names), strict=True):
            at = slice(end - size, end)
            self._plans.append(_Plan(Waypoints(known.object_state[at], known.p_WP[at]), float(share), actions))
        return int(arrays["attempts"])

    def attempt(self, number: int) -> None:
        """Plans from one start, and replays the plan."""
        generator = np.random.default_rng([self._seed, number])
        self._planner.reseed([self._seed, number, 1])
        place = self._start.draw(generator)
        turn = self._planner.turn(place.object_state, place.p_WP)
        # Two of three are like the best one so far, from another start: the most robust one of them is kept again.
        like = self._plans[0].actions @ turn.T if self._plans and number % 3 else None
        plan = self._planner.plan(place.object_state, place.p_WP, like=like)
        if not plan.success:
            return
        self._begin(int(generator.integers(1 << 31)))
        replayed = self._replay(plan, place, generator, plan.actions @ turn)
        if replayed.share > 0.0:
            self._plans = sorted([*self._plans, replayed], key=lambda one: -one.share)[: self._options.plans]

    def _replay(self, plan: ActionPlan, place: Place, generator: np.random.Generator, actions: np.ndarray) -> _Plan:
        """The states, until the task was done, of those replays of a plan from a place that did it."""
        worlds, W = self._replays, self._replays.num_worlds
        worlds.begin(np.arange(W))  # for the domains
        worlds.set_object_states(np.tile(place.object_state, (W, 1)), place.p_WP + generator.normal(0.0, _SLIP, (W, 3)))
        noise = generator.normal(0.0, self._options.noise, (W, *plan.actions.shape))
        wanted = worlds.task.translation(plan.actions, 1.0)[:, worlds.task.axis_indices]
        seen, went, success = [_states(worlds)], [], np.zeros(W, bool)
        for going, out in carried_out(worlds, np.clip(wanted + noise, -1.0, 1.0)):
            seen.append(_states(worlds))
            went.append(going)
            success |= going & out.terminated & (worlds.task.worth(out.progress) > _WORTH)
        kept = np.array(went) & success  # (T, W)
        object_state, p_WP = (np.array(column)[:-1][kept] for column in zip(*seen, strict=True))
        return _Plan(Waypoints(object_state, p_WP), float(success.mean()), actions)


def _states(worlds: Worlds) -> tuple[np.ndarray, np.ndarray]:
    return worlds.run.object_state.copy(), worlds.run.p_WP.copy()
