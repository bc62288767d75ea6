"""The model-predictive controller in the place of a policy: from the environment's observation to an action."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.options import longest_translation
from pinwm_drake.systems.mpc.model import planar_body, rotated
from pinwm_drake.systems.mpc.planner import Plan, PushPlanner
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.tasks.push import LENGTH, SPEED, TURN, PushTask


def make_planner(setup: Setup, task: PushTask, max_translation: float | None = None) -> PushPlanner:
    """Planner of pushes for a scene.

    Args:
        setup: The scene as far as it is known, such as an identified twin, as `environment_setup` makes it.
        task: Goal and tolerances; its `q_WO` is that of the setup's start.
        max_translation: m, longest translation in an action; None for the longest that the pusher's speed allows.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: The translation is not positive or longer than the pusher's speed allows, the task's `q_WO` is
            another one, or the object has no side that the pusher can touch.
    """
    pusher, start = setup.scenario.pusher, setup.scenario.start
    length = longest_translation(setup, max_translation)
    lying, wanted = (np.asarray(q, float) / np.linalg.norm(q) for q in (start.q_WO, task.q_WO))
    if abs(float(lying @ wanted)) < 1.0 - 1e-6:
        raise ParameterError(f"q_WO of the task: got {list(task.q_WO)}; allowed: {list(start.q_WO)}, as in the scene")
    low, high = np.array(pusher.low[:2], float), np.array(pusher.high[:2], float)
    return PushPlanner(planar_body(setup), task, length, low, high)


class PushMpcPolicy:
    """Policy of the push task that plans from the observation `state`, with the signature of SB3's `predict`.

    It hands its plans out as the policy's state and takes them back with the next observation: it keeps nothing itself.

    Attributes:
        planner: Planner of the pushes.
        max_translation: m, longest translation in an action.
    """

    def __init__(self, setup: Setup, task: PushTask, max_translation: float | None = None) -> None:
        self.planner = make_planner(setup, task, max_translation)
        self.max_translation, self._goal = self.planner.max_translation, np.array(task.goal, float)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, tuple[Plan | None, ...]]:
        """Actions (2,) or (W, 2) in [-1, 1]^2 along x and y, and the plans behind them.

        Args:
            observation: Observation of one world or of W: the state (11,) or (W, 11) of `PushTask`, or a dict that has
                it under `state`.
            state: The plans that came back last; None to plan anew.
            episode_start: (W,) bool, true where an episode begins: plans before it are dropped.
            deterministic: Not used: it always is.

        Raises:
            ParameterError: The observation has no state.
        """
        seen = observation.get("state") if isinstance(observation, Mapping) else observation
        rows = np.asarray(seen if seen is not None else np.zeros(0), float)
        if rows.ndim not in (1, 2) or rows.shape[-1] != PushTask.state_size:
            raise ParameterError(
                f"observation: got {_named(observation)}; allowed: `state`, {PushTask.state_size} numbers"
            )
        worlds = np.atleast_2d(rows)
        plans: list[Plan | None] = list(state) if state is not None else [None] * len(worlds)
        if len(plans) != len(worlds):
            raise ParameterError(f"state: got plans of {len(plans)} worlds; allowed: {len(worlds)}, or None")
        if episode_start is not None:
            begins = np.broadcast_to(np.asarray(episode_start, bool), len(worlds))
            plans = [None if begin else plan for begin, plan in zip(begins, plans, strict=True)]
        plans = [self._plan(row, plan) for row, plan in zip(worlds, plans, strict=True)]
        d_W = np.array([np.zeros(2) if plan is None else plan.d_W for plan in plans])
        actions = np.clip(d_W / self.max_translation, -1.0, 1.0).astype(np.float32)
        return (actions[0] if rows.ndim == 1 else actions), tuple(plans)

    def _plan(self, row: np.ndarray, last: Plan | None) -> Plan | None:
        if not np.isfinite(row).all():
            return None
        return self.planner.plan(*self.read(row), last)

    def read(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Planar state (6) of `PlanarBody` and pusher's position (2) m, world, from an observation (11,)."""
        goal, yaw = self._goal[:2], self._goal[2]
        turned = yaw + float(np.arctan2(row[3], row[2]))
        offset = rotated(self.planner.body.p_OB, turned)
        turn = TURN * float(row[6])
        p_WB = goal + rotated(LENGTH * row[0:2], yaw) + offset
        v_WB = rotated(SPEED * row[4:6], yaw) + turn * np.array([-offset[1], offset[0]])
        x = np.array([*p_WB, np.remainder(turned + np.pi, 2 * np.pi) - np.pi, *v_WB, turn])
        return x, goal + rotated(LENGTH * row[9:11], yaw)


def _named(observation: Any) -> str:
    if isinstance(observation, Mapping):
        return f"a dict with {', '.join(map(str, observation))}"
    return f"an array of shape {np.shape(observation)}"
