# SPDX-License-Identifier: MIT
"""The nonlinear program behind a plan: up to two pushes, each at one edge, after which the object rests at the goal."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from pinwm_drake.systems.mpc.model import SUB_STEPS, PlanarBody, coast, coasting_time, push_step

ACTIONS = 3  # actions of a push, at most
GAP = 4e-3  # m, between pusher and edge when a push begins
_MARGIN = 4e-3  # m, from the ends of an edge
_EFFORT = 1e-3  # cost of an action of full length, in the units of the objective
_PUSH = 1 + 2 * ACTIONS  # variables of a push
# The solver stops when its objective has changed by no more than this share of max(1, objective), three times.
_CHANGE, _ITERATIONS = 1e-2, 30


@dataclass(frozen=True, eq=False)
class PlannedPush:
    """A push, as the program has it.

    Attributes:
        edge: Index of an edge of the outline; None for no push.
        along: m, from the edge's first corner to the place where the pusher begins.
        actions: (ACTIONS, 2), ways of the pusher toward the object along the edge's normal as it is when the push
            begins, and along the edge, both in units of the longest translation.
    """

    edge: int | None
    along: float
    actions: np.ndarray

    @classmethod
    def none(cls) -> "PlannedPush":
        """Return an absent push, in the place of a second one."""
        return cls(None, 0.0, np.zeros((ACTIONS, 2)))


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of the program.

    Attributes:
        pushes: The two pushes.
        rests: (2, 3) m and rad, pose of B at rest after each push.
        error: (3) error of the last pose from the goal, in units of the tolerances.
        d_W: (ACTIONS, 2) m, world: translations of the first push.
    """

    pushes: tuple[PlannedPush, PlannedPush]
    rests: np.ndarray
    error: np.ndarray
    d_W: np.ndarray

    @property
    def miss(self) -> float:
        """Norm of the error, in units of the tolerances."""
        return float(np.linalg.norm(self.error))


class PushProgram:
    """Nonlinear program that improves translations of the pusher.

        minimise    |error|^2 + effort |u|^2
        over        the place on its edge where each push begins, and its actions u
        such that   no action is longer than the longest, and the pusher stays on the edge

    where the error is that of the pose at rest after the second push, in units of the tolerances, by `push_step` and
    `coast`: single shooting, IPOPT with exact derivatives.

    Args:
        body: The model of the scene.
        max_translation: m, longest translation in an action.
        scales: m and rad, tolerances: the units of the errors.
    """

    def __init__(self, body: PlanarBody, max_translation: float, scales: tuple[float, float]) -> None:
        self.body, self._longest = body, max_translation
        outline = body.outline
        self._edges = np.column_stack([outline.corners, outline.normals])
        self.stretches = [outline.stretch(edge, body.radius, _MARGIN) for edge in range(len(outline.corners))]
        x, p, free = ca.SX.sym("x", 6), ca.SX.sym("p", 2), ca.SX.sym("free")
        edges, goal = ca.SX.sym("edges", 4, 2), ca.SX.sym("goal", 3)
        w = ca.SX.sym("w", 2 * _PUSH)
        parameters = ca.vertcat(x, p, free, ca.vec(edges), goal)
        begin = free * self._start(x, w[0], edges[:, 0]) + (1 - free) * p
        first, _, d_W, along_1 = self._push(x, begin, w[1:_PUSH], edges[:, 0])
        still = ca.vertcat(first, ca.SX.zeros(3))
        begin = self._start(still, w[_PUSH], edges[:, 1])
        second, _, _, along_2 = self._push(still, begin, w[_PUSH + 1 :], edges[:, 1])
        error = (second - goal) / ca.DM([scales[0], scales[0], scales[1]])
        lengths = [ca.sumsqr(w[k : k + 2]) for j in (1, _PUSH + 1) for k in range(j, j + 2 * ACTIONS, 2)]
        cost = ca.sumsqr(error) + _EFFORT * sum(lengths)
        constraints = ca.vertcat(*lengths, *along_1, *along_2)
        options: dict[str, Any] = {
            "print_time": False,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.max_iter": _ITERATIONS,
            "ipopt.acceptable_tol": 1e3,
            "ipopt.acceptable_obj_change_tol": _CHANGE,
            "ipopt.acceptable_iter": 3,
            "ipopt.mu_init": 1e-3,
        }
        problem = {"x": w, "p": parameters, "f": cost, "g": constraints}
        self._solver = ca.nlpsol("push_mpc", "ipopt", problem, options)
        self._read = ca.Function("read", [w, parameters], [first, second, error, ca.horzcat(*d_W).T])
        self._where = ca.Function("where", [x, w[0], edges[:, 0]], [self._start(x, w[0], edges[:, 0])])
        u = ca.SX.sym("u", 2 * ACTIONS)
        rest, ends, d_W, along = self._push(x, p, u, edges[:, 0])
        # The pose at rest after actions u of a pusher that is at p; the pusher then; its place on the edge after each
        # action; and the time for which the object slides on.
        outputs = [rest, p + sum(d_W), ca.vertcat(*along), coasting_time(body, ends)]
        self.rest_after = ca.Function("rest_after", [x, p, u, edges[:, 0]], outputs)

    def edge(self, edge: int) -> np.ndarray:
        """First corner [m] and outward normal of an edge, together (4,), frame B."""
        return self._edges[edge]

    def start(self, pose: np.ndarray, push: PlannedPush) -> np.ndarray:
        """Position (2,) m, world, at which the pusher begins a push of an object at a pose of B (3)."""
        assert push.edge is not None
        found = self._where([*pose[:3], 0.0, 0.0, 0.0], push.along, self._edges[push.edge])
        return np.asarray(found, float).ravel()

    def solve(
        self,
        x: np.ndarray,
        p: np.ndarray | None,
        pushes: tuple[PlannedPush, PlannedPush],
        goal: np.ndarray,
        left: int = ACTIONS,
    ) -> Solution:
        """Improves two pushes.

        Args:
            x: (6) planar state when the first push begins.
            p: (2) m, world: position of the pusher then; None where it may begin anywhere on the edge.
            pushes: Pushes to start from; a push without an edge stays none.
            goal: (3) m and rad, pose of B; the yaw is taken as it is, so that it should be the turn that is meant.
            left: Number of actions of the first push that may be used.
        """
        edges = [self._edges[push.edge or 0] for push in pushes]
        parameters = np.concatenate([x, np.zeros(2) if p is None else p, [float(p is None)], *edges, goal])
        low, high = np.zeros(2 * _PUSH), np.zeros(2 * _PUSH)
        least, most = np.zeros(4 * ACTIONS), np.ones(4 * ACTIONS)
        least[: 2 * ACTIONS] = -np.inf
        for k, push in enumerate(pushes):
            at, on = k * _PUSH, slice((2 + k) * ACTIONS, (3 + k) * ACTIONS)
            if push.edge is None:
                least[on], most[on] = -np.inf, np.inf
                continue
            begin, end = self.stretches[push.edge]
            least[on], most[on] = begin, end
            used = left if k == 0 else ACTIONS
            low[at + 1 : at + 1 + 2 * used : 2], high[at + 1 : at + 1 + 2 * used] = 0.0, 1.0
            low[at + 2 : at + 2 + 2 * used : 2] = -1.0
            if k == 1 or p is None:
                low[at], high[at] = begin, end
            elif used < ACTIONS:
                least[on.start + used : on.stop], most[on.start + used : on.stop] = -np.inf, np.inf
        guess = np.clip(np.concatenate([[push.along, *push.actions.ravel()] for push in pushes]), low, high)
        found = self._solver(x0=guess, p=parameters, lbx=low, ubx=high, lbg=least, ubg=most)
        w = np.asarray(found["x"], float).ravel()
        w = np.clip(w if np.isfinite(w).all() else guess, low, high)
        first, second, error, d_W = (np.asarray(value, float) for value in self._read(w, parameters))
        one, other = (
            PlannedPush(push.edge, float(values[0]), values[1:].reshape(ACTIONS, 2))
            for push, values in zip(pushes, w.reshape(2, _PUSH), strict=True)
        )
        return Solution((one, other), np.stack([first.ravel(), second.ravel()]), error.ravel(), d_W)

    def _start(self, x: ca.SX, along: ca.SX, edge: ca.SX) -> ca.SX:
        """Position (2) m, world, of a pusher that is a gap off a place on an edge."""
        off = self.body.radius + GAP
        point = ca.vertcat(edge[0] - edge[3] * along + off * edge[2], edge[1] + edge[2] * along + off * edge[3])
        c, s = ca.cos(x[2]), ca.sin(x[2])
        return x[:2] + ca.vertcat(c * point[0] - s * point[1], s * point[0] + c * point[1])

    def _push(self, x: ca.SX, p: ca.SX, u: ca.SX, edge: ca.SX) -> tuple[ca.SX, ca.SX, list[ca.SX], list[ca.SX]]:
        """Outcome of the actions u (2 ACTIONS) of one push.

        Returns:
            Pose at rest (3); planar state (6) after the last action; translations (2) m, world, of the actions; and the
            pusher's place on the edge after each, m from its first corner.
        """
        c, s = ca.cos(x[2]), ca.sin(x[2])
        n = ca.vertcat(c * edge[2] - s * edge[3], s * edge[2] + c * edge[3])
        t = ca.vertcat(-n[1], n[0])
        translations, along = [], []
        for k in range(ACTIONS):
            d = self._longest * (u[2 * k + 1] * t - u[2 * k] * n)
            for _ in range(SUB_STEPS):
                x, p = push_step(self.body, x, p, d / self.body.horizon, edge)
            translations.append(d)
            c, s = ca.cos(x[2]), ca.sin(x[2])
            away = p - x[:2]
            seen = ca.vertcat(c * away[0] + s * away[1], c * away[1] - s * away[0])
            along.append(edge[2] * (seen[1] - edge[1]) - edge[3] * (seen[0] - edge[0]))
        return coast(self.body, x), x, translations, along
