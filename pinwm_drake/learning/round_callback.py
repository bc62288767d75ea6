# SPDX-License-Identifier: MIT
"""Rounds of SB3's algorithms: their learning and progress, and the state in which they are kept within a round."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import ConstantSchedule
from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_wrapper
from torch import nn

from pinwm_drake.learning.heading import AlongHeading
from pinwm_drake.learning.options import RewardOptions
from pinwm_drake.learning.policy import Policy
from pinwm_drake.learning.rounds import EVALUATION_SEED, Rounds, StageRun
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.world_evaluation import evaluate_worlds

_SEEN = "seen."
_NEVER = 1 << 30
Arrays = dict[str, np.ndarray]


class RoundCallback(BaseCallback):
    """Callback that reports rollouts, and keeps the round before the next one."""

    def __init__(self, rounds: Rounds, env: VecEnv, size: int, learner: "Learner") -> None:
        """Take the round that has begun.

        Args:
            rounds: The rounds.
            env: The worlds.
            size: Number of steps of all worlds in the round.
            learner: Algorithm that learns.
        """
        super().__init__()
        self._rounds, self._env, self._size, self._learner, self._rollouts = rounds, env, size, learner, 0

    def _on_rollout_start(self) -> None:
        if self._done and self._rounds.due(self._env):
            seen: Any = self.model._last_obs
            named = seen if isinstance(seen, dict) else {"": seen}
            arrays = {f"{_SEEN}{name}": values for name, values in named.items()}
            arrays |= {"starts": self.model._last_episode_starts, "done": np.array(self._done)}
            self._rounds.keep(self._env, self._learner.kept(self._done) | arrays)

    def _on_rollout_end(self) -> None:
        self._rollouts += 1
        if self._rollouts % self._learner.period:
            return
        successes = self.model.ep_success_buffer
        self._rounds.tell(
            self._done / self._size,
            steps=self._done,
            loss=self._learner.last_loss(),
            recent=float(np.mean(successes)) if successes else math.nan,
        )

    def _on_step(self) -> bool:
        return True

    @property
    def _done(self) -> int:
        return self.model.num_timesteps - self._rounds.steps


def begin_round(model: BaseAlgorithm, rounds: Rounds, kept: Mapping[str, np.ndarray] | None) -> int:
    """Begins a round, or goes on with one that was kept.

    Args:
        model: The algorithm; its networks are not touched.
        rounds: The rounds.
        kept: Arrays that `RoundCallback` kept; None where the round begins.

    Returns:
        Number of steps of all worlds that are done in the round.
    """
    if kept is None:
        model._last_obs, model.num_timesteps = None, rounds.steps  # Without an observation SB3 resets the worlds.
        return 0
    seen: Any = {name.removeprefix(_SEEN): values for name, values in kept.items() if name.startswith(_SEEN)}
    model._last_obs = seen.get("", seen)
    heading = None if model.env is None else unwrap_vec_wrapper(model.env, AlongHeading)
    if heading is not None:
        heading.seen(model._last_obs)
    model._last_episode_starts = kept["starts"]
    done = int(kept["done"])
    model.num_timesteps = rounds.steps + done
    return done


class Learner:
    """Algorithm of SB3 that learns a policy in rounds.

    Attributes:
        model: SB3's algorithm.
        spec: Specification of the policy.
        options: Settings of the algorithm.
        loss: Name of the loss in SB3's logger.
        period: Number of rollouts between two reports.
        callbacks: Further callbacks of the rollouts.
    """

    model: Any
    spec: PolicySpec
    options: RewardOptions
    loss: str
    period: int = 1
    callbacks: Sequence[BaseCallback] = ()

    def pack(self) -> Arrays:
        """All that is learned, with the optimizers, as arrays."""
        raise NotImplementedError

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `pack`, or of `kept`."""
        raise NotImplementedError

    def network(self) -> nn.Module:
        """Network of the policy, with its present weights."""
        raise NotImplementedError

    def kept(self, done: int) -> Arrays:
        """All that a round needs to go on after some steps, but for worlds and what is seen."""
        return self.pack()

    def prepare(self, rounds: Rounds) -> None:
        """Make ready for the first round of a run."""

    def ended(self, rounds: Rounds, size: int) -> None:
        """Keep what later runs need, when the steps of a round are done."""

    def set_rate(self, share: float) -> None:
        """Set all learning rates to a share of those at first."""
        self.model.lr_schedule = ConstantSchedule(share * self.options.learning_rate)

    def last_loss(self) -> float:
        """Loss of the last update; NaN before the first."""
        return float(self.model.logger.name_to_value.get(self.loss, math.nan))

    def train(self, env: VecEnv, worlds: VecEnv, rollout: int, run: StageRun) -> Policy:
        """Learns round after round.

        Args:
            env: Worlds of the evaluations.
            worlds: The same worlds, as the learner acts in them.
            rollout: Number of steps of all worlds, of which a round has a multiple.
            run: The run.

        Returns:
            The best policy, by its evaluations.

        Raises:
            InputError: A checkpoint cannot be used, or a file cannot be written.
        """
        options, model = self.options, self.model
        size = rollout * math.ceil(min(options.round_steps, options.steps) / rollout)
        rounds = Rounds(run.telling(options, self.spec, env), math.ceil(options.steps / size))
        model.set_logger(rounds.logger)
        if rounds.number:
            self.unpack(rounds.arrays)
        if not rounds.ended(options.patience):
            self.prepare(rounds)
        while not rounds.ended(options.patience):
            rounds.begin(worlds)
            self.set_rate(rounds.falling(options.last_share))
            kept = rounds.restore(worlds)
            if kept is not None:
                self.unpack(kept)
            done = begin_round(model, rounds, kept)
            callbacks = [RoundCallback(rounds, worlds, size, self), *self.callbacks]
            model.learn(size - done, callback=callbacks, reset_num_timesteps=False, log_interval=_NEVER)
            loss = self.last_loss()
            self.ended(rounds, size)
            actor = self.network()
            found = evaluate_worlds(env, Policy(self.spec, actor), options.episodes, seed=EVALUATION_SEED)
            rounds.end(self.pack(), actor, found, steps=size, loss=loss)
        return Policy(self.spec, rounds.best_actor(self.spec))
