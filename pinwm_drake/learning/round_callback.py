"""Rounds of SB3's algorithms: their progress, and the state in which they are kept within a round."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_wrapper

from pinwm_drake.learning.heading import AlongHeading
from pinwm_drake.learning.rounds import Rounds

_SEEN = "seen."
Arrays = dict[str, np.ndarray]


class RoundCallback(BaseCallback):
    """Callback that reports rollouts, and keeps the round before the next one."""

    def __init__(
        self,
        rounds: Rounds,
        env: VecEnv,
        size: int,
        arrays: Callable[[], Mapping[str, np.ndarray]],
        *,
        loss: str,
        period: int = 1,
    ) -> None:
        """Takes the round that has begun.

        Args:
            rounds: The rounds.
            env: The worlds.
            size: Number of steps of all worlds in the round.
            arrays: Gives the arrays of what is learned; the observation and the number of steps are added.
            loss: Name of the loss in SB3's logger.
            period: Number of rollouts between two reports.
        """
        super().__init__()
        self._rounds, self._env, self._size, self._arrays = rounds, env, size, arrays
        self._loss, self._period, self._rollouts = loss, period, 0

    def _on_rollout_start(self) -> None:
        if self._done:
            self._rounds.keep(self._env, lambda: {**self._arrays(), **begun(self.model, self._rounds.steps)})

    def _on_rollout_end(self) -> None:
        self._rollouts += 1
        if self._rollouts % self._period:
            return
        successes = self.model.ep_success_buffer
        self._rounds.tell(
            self._done / self._size,
            steps=self._done,
            loss=float(self.model.logger.name_to_value.get(self._loss, math.nan)),
            recent=float(np.mean(successes)) if successes else math.nan,
        )

    def _on_step(self) -> bool:
        return True

    @property
    def _done(self) -> int:
        return self.model.num_timesteps - self._rounds.steps


def begun(model: BaseAlgorithm, steps: int) -> Arrays:
    """Arrays of what the next rollout begins with, for `begin_round`; `steps` were done before the round."""
    seen: Any = model._last_obs
    named = seen if isinstance(seen, dict) else {"": seen}
    starts = model._last_episode_starts
    assert starts is not None
    done = {"starts": starts, "done": np.array(model.num_timesteps - steps)}
    return {f"{_SEEN}{name}": values for name, values in named.items()} | done


def begin_round(model: BaseAlgorithm, rounds: Rounds, kept: Mapping[str, np.ndarray] | None) -> int:
    """Begins a round, or goes on with one that was kept.

    Args:
        model: The algorithm; its networks are not touched.
        rounds: The rounds.
        kept: Arrays that hold those of `begun`; None where the round begins.

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
        heading.see(model._last_obs)
    model._last_episode_starts = kept["starts"]
    done = int(kept["done"])
    model.num_timesteps = rounds.steps + done
    return done
