# SPDX-License-Identifier: MIT
"""Sampling-based model-predictive control of any task: sequences of actions are tried in a twin and its cousins.

Source: cross-entropy method with elites that are kept, noise that is correlated over time, and a warm start, after
    Pinneri et al., "Sample-efficient cross-entropy method for real-time planning" (iCEM, CoRL 2020).
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RotationMatrix

from pinwm_drake.cousins.cousin import CousinDraw
from pinwm_drake.errors import require
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.worlds import Advance, Worlds
from pinwm_drake.systems.mpc.acting import MpcPolicy
from pinwm_drake.systems.mpc.strokes import Strokes
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.tasks.registry import recipe_of
from pinwm_drake.tasks.task import Task

_STROKES = 0.5  # share of a first round's sequences that are strokes at the object
_FAILURE = 10.0  # cost of a sequence that the physics finds no solution for


@dataclass(frozen=True)
class SamplingOptions:
    """Options of the search.

    Attributes:
        samples: Number of sequences tried at once, one in each of the twin's worlds.
        horizon: Number of actions of a sequence.
        iterations: Number of rounds for each action that is carried out.
        first_iterations: Number of rounds for the first action of an episode.
        polish: Number of rounds after the first that found a success, at most.
        cousins: Number of models, the twin and cousins of it, in each of which a sequence is tried once one has
            succeeded; fewer where too few sequences were left. 1 for the twin alone.
        delta: Relative half-width of the cousins' ranges.
        elites: Number of the best sequences, which the next round is drawn around.
        kept: Number of these that are tried again in the next round.
        spread: Standard deviation of an action's components in the first round, in units of the longest translation.
        least_spread: The least one, in any round.
        correlation: Correlation of an action's noise with that of the action before, 0 to below 1.
        momentum: Share of the last mean and spread in the next ones.
        effort: Cost of an action of full length; it grows with the square. Of plans that do the task, one that
            leaves the object alone is also one that holds where the twin is wrong.
        seed: Seed of the draws.

    Raises:
        ParameterError: An option is out of range.
    """

    samples: int = 256
    horizon: int = 10
    iterations: int = 3
    first_iterations: int = 12
    polish: int = 3
    cousins: int = 8
    delta: float = 0.1
    elites: int = 8
    kept: int = 3
    spread: float = 0.7
    least_spread: float = 0.1
    correlation: float = 0.5
    momentum: float = 0.1
    effort: float = 0.1
    seed: int = 0

    def __post_init__(self) -> None:
        require("samples", self.samples, 2 <= self.samples <= 65536, "2 to 65536")
        require("horizon", self.horizon, 1 <= self.horizon <= 1000, "1 to 1000")
        for name in ("iterations", "first_iterations", "polish"):
            require(name, getattr(self, name), 1 <= getattr(self, name) <= 1000, "1 to 1000")
        require("elites", self.elites, 1 <= self.elites <= self.samples, "1 to the number of samples")
        require("kept", self.kept, 0 <= self.kept <= self.elites, "0 to the number of elites")
        require("cousins", self.cousins, 1 <= self.cousins <= 1000, "1 to 1000")
        for name in ("spread", "least_spread"):
            require(name, getattr(self, name), 0 < getattr(self, name) <= 10, "more than 0, up to 10")
        require("effort", self.effort, 0 <= self.effort <= 100, "0 to 100")
        for name in ("correlation", "momentum"):
            require(name, getattr(self, name), 0 <= getattr(self, name) < 1, "0 to below 1")


@dataclass(frozen=True, eq=False)
class ActionPlan:
    """Sequence of actions with the return that the twin promises, or the twin and its cousins.

    Attributes:
        actions: (horizon, n) in [-1, 1], the next one first.
        value: Sum of its rewards, less the effort; the mean where it was tried in several models.
        success: Flag: it ends with success, in more than half of the models.
    """

    actions: np.ndarray
    value: float
    success: bool


class SamplingMpc(MpcPolicy[ActionPlan]):
    """Planner of a task by sequences of actions that are tried in a twin and its cousins, and a policy.

    What it draws as a policy follows from its seed and the observation, so that an episode repeats in whatever world,
    after whatever others.

    Args:
        setup: The scene as far as it is known, such as an identified twin.
        task: The task, whose reward for training counts; None for the scene's.
        max_translation: m, longest translation in an action; None for the longest that the pusher's speed allows.
        options: Options of the search.

    Attributes:
        worlds: One world for each sample, in turn of the twin and of each cousin.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: The translation is not positive or longer than the pusher's speed allows.
    """

    def __init__(
        self,
        setup: Setup,
        task: Task | None = None,
        max_translation: float | None = None,
        options: SamplingOptions | None = None,
    ) -> None:
        self.options = options or SamplingOptions()
        task = setup.task if task is None else task
        settings = EnvOptions(
            task=task.for_training(),
            max_translation=max_translation,
            max_steps=self.options.horizon,
            time_step=recipe_of(task).training_step,
        )
        self.worlds = Worlds(setup, "twin", self.options.samples, settings)
        self.task, self.worlds.most_force = self.worlds.task, recipe_of(task).most_force
        self._random = np.random.default_rng(self.options.seed)
        # Twice as many sequences as elites have to be left where each is tried in all cousins.
        self._tries = max(1, min(self.options.cousins, self.options.samples // (2 * self.options.elites)))
        cousins = CousinDraw(setup.twin, delta=self.options.delta, seed=self.options.seed)
        for world in range(self.options.samples):
            if number := world % self._tries:
                self.worlds.run.set_domain(cousins.cousin(number), world, colours=False)
        self._strokes = Strokes(self.worlds, self.options.horizon) if Strokes.apply(self.worlds) else None
        place = StartDistribution(self.worlds.setup).middle()
        self._usual = place.object_state, place.p_WP

    def act(self, row: np.ndarray, last: ActionPlan | None) -> tuple[ActionPlan, np.ndarray]:
        """Plan of one world, and its first action; see `MpcPolicy.act`."""
        object_state, p_WP = self.task.object_state(row[None])
        digest = hashlib.blake2b(row.tobytes(), digest_size=16).digest()
        self.reseed([self.options.seed, int.from_bytes(digest, "little")])
        plan = self.plan(object_state[0], p_WP[0], last)
        return plan, plan.actions[0]

    def plan(
        self,
        object_state: np.ndarray,
        p_WP: np.ndarray,
        last: ActionPlan | None = None,
    ) -> ActionPlan:
        """Return a sequence of actions that succeeds in most of the models, or the best that is found.

        Once one has succeeded, each is tried in the twin and its cousins, and the mean of its values counts. The result
        is the middle of the last round's good ones where that succeeds, which bears more than the best of them.
        A part of the first round's sequences are strokes at the object, where the task moves the pusher in space.

        Args:
            object_state: (13,) q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world; a component that is NaN is that of
                the middle of the scene's starts, or 0.
            p_WP: (3,) m, world: position of the pusher; likewise.
            last: Plan whose first action has been carried out, for a warm start; None at the beginning.
        """
        options, n = self.options, self.task.action_size
        object_state, p_WP = (
            np.where(np.isnan(given), usual, given)
            for given, usual in zip((object_state, p_WP), self._usual, strict=True)
        )
        mean, spread = np.zeros((options.horizon, n)), np.full((options.horizon, n), options.spread)
        kept = np.zeros((0, options.horizon, n))
        if last is not None:
            like = np.concatenate([last.actions[1:], last.actions[-1:]])
            kept = like[None]
            mean, spread = like.copy(), np.full_like(spread, 0.5 * options.spread)
        best, middle, left = None, None, options.first_iterations if last is None else options.iterations
        tries = 1 if last is None or not last.success else self._tries
        while left > 0:
            drawn = np.clip(mean + spread * self._noise(n)[::tries][: options.samples // tries], -1.0, 1.0)
            drawn[: len(kept)] = kept
            if best is not None:
                drawn[-1] = mean
            if best is None and self._strokes is not None:
                part = drawn[-round(_STROKES * len(drawn)) :]
                strokes = self._strokes.draw(self._random, len(part), object_state, p_WP)
                part[:] = strokes @ heading_turn(self.task, object_state, p_WP).T
            # Worlds that are left over try some once more, which does not count.
            tried = np.resize(np.repeat(drawn, tries, axis=0), (options.samples, *drawn.shape[1:]))
            found = self._values(tried, object_state, p_WP)
            values, shares = (one[: tries * len(drawn)].reshape(-1, tries).mean(1) for one in found)
            if best is not None:
                middle = ActionPlan(mean.copy(), float(values[-1]), bool(shares[-1] > 0.5))
            order = np.argsort(-values, kind="stable")[: options.elites]
            elites, first = drawn[order], order[0]
            if best is None or values[first] > best.value:
                best = ActionPlan(drawn[first].copy(), float(values[first]), bool(shares[first] > 0.5))
            mean = options.momentum * mean + (1.0 - options.momentum) * elites.mean(0)
            spread = options.momentum * spread + (1.0 - options.momentum) * elites.std(0)
            spread = np.maximum(spread, options.least_spread)
            kept = elites[: options.kept]
            left = min(left - 1, options.polish) if best.success else left - 1
            if best.success and tries < self._tries and left > 0:
                # What succeeded once is among the sequences that are kept; in the cousins it has another value.
                tries, best = self._tries, ActionPlan(best.actions, -math.inf, success=True)
                kept = elites[: max(options.kept, 1)]
        assert best is not None
        # The middle of many good plans bears more than the best of them, which may hang on a hair.
        return middle if middle is not None and middle.success else best

    def reseed(self, seed: int | Sequence[int]) -> None:
        """Draws from now on as a planner does that was made with this seed."""
        self._random = np.random.default_rng(seed)

    def _noise(self, n: int) -> np.ndarray:
        share = self.options.correlation
        white = self._random.normal(size=(self.options.samples, self.options.horizon, n))
        for k in range(1, self.options.horizon):
            white[:, k] = share * white[:, k - 1] + np.sqrt(1.0 - share**2) * white[:, k]
        return white

    def _values(self, actions: np.ndarray, object_state: np.ndarray, p_WP: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sum (W,) of rewards, and successes (W,), of sequences (W, horizon, n); a failure of the physics ends one."""
        worlds, W = self.worlds, len(actions)
        worlds.set_object_states(np.tile(object_state, (W, 1)), np.tile(p_WP, (W, 1)))
        total, success = np.zeros(W), np.zeros(W, bool)
        for k, (going, out) in enumerate(carried_out(worlds, actions)):
            total -= np.where(going, self.options.effort * (actions[:, k] ** 2).sum(1), 0.0)
            failed = np.isin(np.arange(W), list(out.failures))
            total += np.where(going, np.where(failed, -_FAILURE, out.reward), 0.0)
            success |= going & out.progress.success
        return total, success


def heading_turn(task: Task, object_state: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
    """Turn (n, n) of actions from x to the way from object to pusher; none where the task minds its yaw.

    Args:
        task: The task.
        object_state: (13,) q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world.
        p_WP: (3,) m, world: position of the pusher.
    """
    away = p_WP - object_state[4:7]
    yaw = 0.0 if recipe_of(task).heading is None else math.atan2(away[1], away[0])
    axes = task.axis_indices
    return np.asarray(RotationMatrix.MakeZRotation(yaw).matrix()[np.ix_(axes, axes)])


def carried_out(worlds: Worlds, actions: np.ndarray) -> Iterator[tuple[np.ndarray, Advance]]:
    """Outcomes of sequences of actions (W, horizon, n), one action after another, until no world goes on any more.

    Each comes with (W,) bool, true for the worlds that had neither succeeded nor failed before that action.
    """
    going = np.ones(len(actions), bool)
    for k in range(actions.shape[1]):
        out = worlds.advance(actions[:, k])
        yield going.copy(), out
        going &= ~out.terminated
        going[list(out.failures)] = False
        if not going.any():
            return
