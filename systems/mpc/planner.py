# SPDX-License-Identifier: MIT
"""Planner of pushes, anew in every action: from an object's state and the pusher's position to a translation."""

from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca
import numpy as np

from pinwm_drake.systems.mpc.model import PlanarBody, coast, coasting_time, rotated
from pinwm_drake.systems.mpc.path import Walk
from pinwm_drake.systems.mpc.program import ACTIONS, PlannedPush, PushProgram, Solution
from pinwm_drake.systems.mpc.table import PushTable, missed_cost
from pinwm_drake.tasks.push import PushTask

Phase = Literal["approach", "push", "wait"]
_ENOUGH = 0.8  # share of the tolerances within which a coasting object is left alone
# A choice that misses by less [tolerances] is good; after so many tries a good one ends the search.
_GOOD, _TRIED = 0.8, 3
_NOTHING = 0.1  # tolerances, by which a push moves an object at least
_THERE = 1e-3  # m, from where a push begins
_ELSEWHERE = 3e-3  # m, the pusher from where the last plan had it: it was moved by something else


@dataclass(frozen=True, eq=False)
class Plan:
    """Plan of up to two pushes, with the next action.

    Attributes:
        phase: "approach" a push, "push", or "wait" for the object to come to rest at the goal.
        d_W: (2) m, world: translation of the next action.
        p_WP: (2) m, world: position of the pusher after it.
        pushes: The present push and the next.
        left: Number of actions of the present push that are left after the next action.
        rests: (k, 3) m and rad, poses of B in which the object comes to rest after the pushes, by the model.
        goal: (3) m and rad, pose of B at the goal; the yaw may be any number of turns away.
        miss: Norm of the error of the last rest, in tolerances.
        yaw: rad, yaw of B now, without jumps since the plan was begun.
        barren: An edge at which the last plan wanted to push and then found that of no use; None where there is none.
    """

    phase: Phase
    d_W: np.ndarray
    p_WP: np.ndarray
    pushes: tuple[PlannedPush, PlannedPush]
    left: int
    rests: np.ndarray
    goal: np.ndarray
    miss: float
    yaw: float
    barren: int | None = None


@dataclass(frozen=True, eq=False)
class _Now:
    """Present state: planar state x (6), pusher p (2) m, and pose (3) and time (1) s in which the object rests."""

    x: np.ndarray
    p: np.ndarray
    rest: np.ndarray
    time: np.ndarray


class PushPlanner:
    """Planner with a receding horizon of two pushes.

    Without a plan, or after a push, two pushes are chosen from the table and improved by the program. The pusher goes
    round the object to where the first begins; from there on the program is solved in every action, with the state as
    it is, until the actions of the push are used up. An object that will come to rest at the goal is left alone.

    Args:
        body: The model of the scene.
        task: Goal and tolerances.
        max_translation: m, longest translation in an action.
        low: (2) m, world: lower corner of the pusher's box.
        high: (2) m, world: upper corner.

    Raises:
        ParameterError: No side of the object is long enough to be pushed.
    """

    def __init__(
        self, body: PlanarBody, task: PushTask, max_translation: float, low: np.ndarray, high: np.ndarray
    ) -> None:
        self.body, self.max_translation = body, max_translation
        self._walk = Walk(body, max_translation, low, high)
        self._scales = np.array([task.tolerance, task.tolerance, task.turn_tolerance])
        self._goal = np.array([*(task.goal[:2] + rotated(body.p_OB, task.goal[2])), task.goal[2]])
        self.program = PushProgram(body, max_translation, (task.tolerance, task.turn_tolerance))
        self._table = PushTable(self.program, self._walk.detours, max_translation, low, high)
        x = ca.SX.sym("x", 6)
        self._coast = ca.Function("coast", [x], [coast(body, x), coasting_time(body, x)])

    def plan(self, x: np.ndarray, p: np.ndarray, last: Plan | None = None) -> Plan:
        """Plans the next action.

        Args:
            x: (6) planar state.
            p: (2) m, world: position of the pusher.
            last: The plan before, if its action led to this state; None to plan anew.
        """
        x, p = x.copy(), p.copy()
        if last is not None and np.hypot(*(last.p_WP - p)) > _ELSEWHERE:
            last = None
        if last is not None:
            x[2] = last.yaw + np.remainder(x[2] - last.yaw + np.pi, 2 * np.pi) - np.pi
        now = _Now(x, p, *(np.asarray(value, float).ravel() for value in self._coast(x)))
        error = (now.rest - self._near_goal(now.rest)) / self._scales
        if max(np.hypot(*error[:2]), abs(error[2])) < _ENOUGH:
            return self._wait(now)
        if last is not None and last.phase == "push" and last.left > 0:
            return self._push(now, last, last.left)
        if last is None or last.phase != "approach":
            last = self._choose(now, None if last is None else last.barren)
        return self._approach(now, last)

    def _near_goal(self, pose: np.ndarray) -> np.ndarray:
        """Goal (3) m and rad as a pose of B, with the yaw, of all whole turns, that is nearest to a pose's."""
        goal = self._goal.copy()
        goal[2] += 2 * np.pi * np.round((pose[2] - goal[2]) / (2 * np.pi))
        return goal

    def _choose(self, now: "_Now", barren: int | None) -> Plan:
        still, goal = np.concatenate([now.rest, np.zeros(3)]), self._near_goal(now.rest)
        waiting = float(now.time[0]) / self.body.horizon
        choices = self._table.choose(now.rest, now.p, goal, self._scales, waiting, barren)
        error = np.linalg.norm((now.rest - goal) / self._scales)
        best: tuple[float, Solution] | None = None
        for k, choice in enumerate(choices):
            if k >= _TRIED and best is not None and best[1].miss < _GOOD:
                break
            found = self.program.solve(still, None, choice.pushes, goal)
            cost = choice.busy + float(missed_cost(np.array(found.miss), np.asarray(error)))
            if best is None or cost < best[0]:
                best = cost, found
        assert best is not None
        found = best[1]
        pushes = found.pushes
        if pushes[1].edge is not None and self._is_nothing(now, found):
            pushes = (pushes[1], PlannedPush.none())
        return Plan(
            "approach", np.zeros(2), now.p, pushes, ACTIONS, found.rests, goal, found.miss, float(now.x[2]), barren
        )

    def _is_nothing(self, now: "_Now", found: Solution) -> bool:
        return float(np.linalg.norm((found.rests[0] - now.rest) / self._scales)) < _NOTHING

    def _approach(self, now: "_Now", plan: Plan) -> Plan:
        end = self.program.start(now.rest, plan.pushes[0])
        if np.hypot(*(end - now.p)) < _THERE:
            return self._push(now, plan, ACTIONS)
        d_W = self._walk.step(now.x, now.p, now.rest, end)
        return replace(plan, phase="approach", d_W=d_W, p_WP=now.p + d_W, left=ACTIONS, yaw=float(now.x[2]))

    def _push(self, now: "_Now", plan: Plan, left: int) -> Plan:
        """Plan with the next action of a push; if that is of no use any more, with the approach of the next push."""
        found, barren = self.program.solve(now.x, now.p, plan.pushes, plan.goal, left), None
        first, second = found.pushes
        if self._is_nothing(now, found):
            if second.edge is not None:
                ahead = replace(plan, pushes=(second, PlannedPush.none()), rests=found.rests[1:], miss=found.miss)
                return self._approach(now, ahead)
            if left < ACTIONS:
                return self._approach(now, self._choose(now, None))
            left, barren = 1, first.edge
        rolled = PlannedPush(first.edge, first.along, np.vstack([first.actions[1:], np.zeros((1, 2))]))
        d_W = self._walk.allowed(now.p, found.d_W[0])
        return Plan(
            phase="push",
            d_W=d_W,
            p_WP=now.p + d_W,
            pushes=(rolled, second),
            left=left - 1,
            rests=found.rests,
            goal=plan.goal,
            miss=found.miss,
            yaw=float(now.x[2]),
            barren=barren,
        )

    def _wait(self, now: "_Now") -> Plan:
        d_W, goal = self._walk.step(now.x, now.p, now.rest, now.p), self._near_goal(now.rest)
        miss = float(np.linalg.norm((now.rest - goal) / self._scales))
        none = (PlannedPush.none(), PlannedPush.none())
        return Plan("wait", d_W, now.p + d_W, none, 0, now.rest[None], goal, miss, float(now.x[2]))
