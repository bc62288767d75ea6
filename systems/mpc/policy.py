# SPDX-License-Identifier: MIT
"""The planner of planar pushes, made for a scene, and in the place of a policy."""

import numpy as np

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.options import longest_translation
from pinwm_drake.systems.mpc.acting import MpcPolicy
from pinwm_drake.systems.mpc.model import planar_body
from pinwm_drake.systems.mpc.planner import Plan, PushPlanner
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.tasks.push import PushTask


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


class PushMpcPolicy(MpcPolicy[Plan]):
    """Policy of the push task that plans pushes at the object's planar outline; arguments as for `make_planner`."""

    def __init__(self, setup: Setup, task: PushTask, max_translation: float | None = None) -> None:
        self.planner, self.task = make_planner(setup, task, max_translation), task

    def act(self, row: np.ndarray, last: Plan | None) -> tuple[Plan, np.ndarray]:
        """Plan of one world, and its first action (2,) along x and y; see `MpcPolicy.act`."""
        plan = self.planner.plan(*self.read(row), last)
        return plan, np.clip(plan.d_W / self.planner.max_translation, -1.0, 1.0)

    def read(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Planar state (6) of `PlanarBody` and pusher's position (2) m, world, from an observation (11,)."""
        object_state, p_WP = self.task.object_state(row[None])
        return self.planner.body.planar(object_state[0]), p_WP[0, :2]
