# SPDX-License-Identifier: MIT
"""A planner in the place of a policy: from the environment's observation to an action."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

import numpy as np

from pinwm_drake.errors import require
from pinwm_drake.tasks.task import Task

PlanT = TypeVar("PlanT")


class MpcPolicy(ABC, Generic[PlanT]):
    """Policy that plans from the observation `state`, with the signature of SB3's `predict`.

    It hands its plans out as the policy's state and takes them back with the next observation: it keeps nothing itself.
    The state is that of `task`.
    """

    task: Task

    @abstractmethod
    def act(self, row: np.ndarray, last: PlanT | None) -> tuple[PlanT, np.ndarray]:
        """Plan of one world, and its first action (n,) in [-1, 1]^n.

        Args:
            row: (state_size,), finite: state of the task.
            last: Plan whose first action has been carried out; None at the beginning.
        """

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, tuple[PlanT | None, ...]]:
        """Actions (n,) or (W, n) in [-1, 1]^n, and the plans behind them; zero and None where a state is not finite.

        Args:
            observation: The task's state, (state_size,) or (W, state_size), or a dict that has it under `state`.
            state: The plans that came back last; None to plan anew.
            episode_start: (W,) bool, true where an episode begins: plans before it are dropped.
            deterministic: Not used: it always is.

        Raises:
            ParameterError: The observation has no state, or there are plans of another number of worlds.
        """
        is_dict, size = isinstance(observation, Mapping), self.task.state_size
        seen = observation.get("state") if is_dict else observation
        rows = np.asarray(seen if seen is not None else np.zeros(0), float)
        given = f"a dict with {', '.join(map(str, observation))}" if is_dict else f"an array of shape {rows.shape}"
        require("observation", given, rows.ndim in (1, 2) and rows.shape[-1] == size, f"`state`, {size} numbers")
        worlds = np.atleast_2d(rows)
        last: list[PlanT | None] = list(state) if state is not None else [None] * len(worlds)
        require("state", f"plans of {len(last)} worlds", len(last) == len(worlds), f"{len(worlds)}, or None")
        begins = np.broadcast_to(np.asarray(episode_start if episode_start is not None else False), len(worlds))
        nothing = None, np.zeros(self.task.action_size)
        found = [
            self.act(row, None if begin else plan) if np.isfinite(row).all() else nothing
            for row, plan, begin in zip(worlds, last, begins, strict=True)
        ]
        actions = np.array([action for _, action in found], np.float32)
        return (actions[0] if rows.ndim == 1 else actions), tuple(plan for plan, _ in found)
