"""Waypoints of a planner's plans, for trainings of tasks that chance hardly ever does."""

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from math import nan as NAN
from pathlib import Path

import numpy as np

from pinwm_drake.checkpoints import read_arrays
from pinwm_drake.errors import require
from pinwm_drake.learning.progress import Pace, Report, Step, silent
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds
from pinwm_drake.systems.envs.worlds import Worlds
from pinwm_drake.systems.mpc.sampling import SamplingMpc, SamplingOptions, carried_out
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.tasks.waypoints import WAYPOINTS_FILE, Waypoints

STAGE = "waypoints"
_WORTH = 0.5  # of a success that counts
_SLIP = 0.002  # m, standard deviation of the pusher's place at the start of a replay


@dataclass(frozen=True)
class WaypointOptions:
    """Settings of the search for waypoints.

    Attributes:
        attempts: Largest number of starts from which the task is planned.
        share: Share of a plan's replays with success from which it counts as robust, and the search ends.
        replays: Number of a plan's replays, in units of the worlds.
        noise: Standard deviation of the noise on the actions of a replay, in units of an action.
        planner: Options of the planner.

    Raises:
        ParameterError: A number is out of range.
    """

    attempts: int = 20
    share: float = 0.35
    replays: int = 4
    noise: float = 0.05
    planner: SamplingOptions = field(default_factory=lambda: SamplingOptions(horizon=12, first_iterations=15))

    def __post_init__(self) -> None:
        """Checks the numbers."""
        for name in ("attempts", "replays"):
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
    """Waypoints of the most robust plan from the starts of a scene, in `folder` as well.

    A plan that works in the twin may hang on a hair there. So each is carried out again in the worlds of the training,
    from other starts and with noise on the actions; what is kept are the states of such replays that did the task, and
    what the plan does there, of the plan with most of them.

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
    done, pace, begun = search.restore(folder, about) if resume else 0, Pace(), time.monotonic()
    while done < options.attempts and search.best.share < options.share:
        search.attempt(done)
        done += 1
        found, best, share = search.best.waypoints, search.best.share, done / options.attempts
        found.write(folder, about, attempts=np.array(done), share=np.array(best), actions=search.best.actions)
        _, left = pace(share, done)
        report(Step(STAGE, share, len(found), best, NAN, NAN, best, time.monotonic() - begun, left=left))
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
    """A plan and its replays, of one attempt after another; each draws from a seed of its own."""

    def __init__(self, worlds: TrainingWorlds, options: WaypointOptions, seed: int) -> None:
        self._options, self._seed, self._begin = options, seed, worlds.begin
        self._replays: Worlds = worlds.worlds("state").worlds
        setup = self._replays.setup
        self._planner = SamplingMpc(setup, worlds.setup.task, self._replays.run.max_translation, options.planner)
        self._start = StartDistribution(setup)
        self.best = _Plan(Waypoints(), 0.0, np.zeros((options.planner.horizon, setup.task.action_size)))

    def restore(self, folder: Path, about: Mapping[str, object]) -> int:
        """Takes over what an earlier search found; gives the number of its attempts."""
        names = [one.name for one in fields(Waypoints)]
        arrays = read_arrays(folder / WAYPOINTS_FILE, about, STAGE, ["attempts", "share", "actions", *names])
        if arrays is None:
            return 0
        found = Waypoints(*(arrays[name] for name in names))
        self.best = _Plan(found, float(arrays["share"]), arrays["actions"])
        return int(arrays["attempts"])

    def attempt(self, number: int) -> None:
        """Plans from one start, and replays the plan."""
        generator = np.random.default_rng([self._seed, number])
        self._planner.reseed([self._seed, number, 1])
        place = self._start.draw(generator)
        turn = self._planner.turn(place.object_state, place.p_WP)
        # Two of three are like the best one so far, from another start: the more robust one of them is kept again.
        like = self.best.actions @ turn.T if self.best.share and number % 3 else None
        plan = self._planner.plan(place.object_state, place.p_WP, like=like)
        if not plan.success:
            return
        self._begin(int(generator.integers(1 << 31)))
        for world, own in enumerate(generator.spawn(self._replays.num_worlds)):
            self._replays.set_generator(world, own)
        actions = self._replays.task.translation(plan.actions, 1.0)[:, self._replays.task.axis_indices] @ turn
        replays = [self._replay(actions, generator) for _ in range(self._options.replays)]
        share = float(np.mean([share for _, share in replays]))
        if share > self.best.share:
            columns = [[getattr(found, column.name) for found, _ in replays] for column in fields(Waypoints)]
            self.best = _Plan(Waypoints(*map(np.concatenate, columns)), share, actions)

    def _replay(self, actions: np.ndarray, generator: np.random.Generator) -> tuple[Waypoints, float]:
        """The waypoints, until the task was done, of those replays of a plan that did it, and the share of these."""
        worlds, W = self._replays, self._replays.num_worlds
        worlds.begin(np.arange(W))  # for the domains
        places = [self._start.draw(generator) for _ in range(W)]
        p_WP = np.array([place.p_WP for place in places]) + generator.normal(0.0, _SLIP, (W, 3))
        worlds.set_object_states(np.array([place.object_state for place in places]), p_WP)
        turns = [self._planner.turn(place.object_state, place.p_WP) for place in places]
        wanted = np.array([actions @ turn.T for turn in turns])
        noise = generator.normal(0.0, self._options.noise, wanted.shape)
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
