# SPDX-License-Identifier: MIT
"""Table of single pushes of an object at rest, and the choice of one or two that bring it to a goal soonest."""

import math
from dataclasses import dataclass

import numpy as np

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.mpc.model import rotated
from pinwm_drake.systems.mpc.path import Detours
from pinwm_drake.systems.mpc.program import ACTIONS, PlannedPush, PushProgram

_SPACING = 0.012  # m, of the places on an edge
_SPEEDS = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0)  # shares of the longest action
_MISSED = 10.0  # actions that an error of a tolerance costs
_FAR = 4.0  # actions that every further tolerance costs
_GAIN = 0.6  # share of the present error: pushes that leave more are no choice while there are others
_NO_CHOICE = 100.0  # actions that are added to the cost of a push that is no choice
_CHOICES, _CANDIDATES = 6, 400


@dataclass(frozen=True, eq=False)
class Choice:
    """Candidate of up to two pushes.

    Attributes:
        pushes: The two pushes, the second maybe none.
        actions: Number of actions that they take, roughly, with those to mend the error that is left.
        busy: Number of actions without those.
    """

    pushes: tuple[PlannedPush, PlannedPush]
    actions: float
    busy: float


class PushTable:
    """Pushes of an object at rest, by the model: at places along its edges, straight in, at several speeds.

    As the floor is the same everywhere, a push does the same to an object in any pose; two pushes are a composition.

    Args:
        program: Program of the pushes, with its model.
        detours: Ways around the object at rest; the others are those of `PushPlanner`.

    Raises:
        ParameterError: No side of the object is long enough to be pushed.
    """

    def __init__(
        self, program: PushProgram, detours: Detours, max_translation: float, low: np.ndarray, high: np.ndarray
    ) -> None:
        self._detours, self._longest, self._low, self._high = detours, max_translation, low, high
        body = program.body
        places = []
        for edge, (begin, end) in enumerate(program.stretches):
            if end > begin:
                count = max(round((end - begin) / _SPACING), 1)
                places += [(edge, begin + (k + 0.5) * (end - begin) / count) for k in range(count)]
        if not places:
            longest = 1e3 * float(body.outline.lengths.max())
            raise ParameterError(
                f"outline: its longest side is {longest:.1f} mm; allowed: one that the pusher can touch"
            )
        self._places = places
        none, home = np.zeros((ACTIONS, 2)), np.zeros(3)
        self._starts = np.stack([program.start(home, PlannedPush(edge, along, none)) for edge, along in places])
        rows = [(k, m, u) for k in range(len(places)) for m in range(1, ACTIONS + 1) for u in _SPEEDS]
        self._place = np.array([row[0] for row in rows])
        self._actions = np.zeros((len(rows), ACTIONS, 2))
        for row, (_, used, speed) in enumerate(rows):
            self._actions[row, :used, 0] = speed
        found = program.rest_after.map(len(rows))(
            np.zeros((6, len(rows))),
            self._starts[self._place].T,
            self._actions.reshape(len(rows), -1).T,
            np.stack([program.edge(places[k][0]) for k in self._place]).T,
        )
        rest, pusher, ends, rolling = (np.asarray(value, float).T for value in found)
        spans = np.array([program.stretches[places[k][0]] for k in self._place])
        good = (ends >= spans[:, :1]).all(axis=1) & (ends <= spans[:, 1:]).all(axis=1)
        good &= np.hypot(rest[:, 0], rest[:, 1]) + body.lever * np.abs(rest[:, 2]) > 2e-3
        self._place, self._actions, self._rest = self._place[good], self._actions[good], rest[good]
        self._edge = np.array([place[0] for place in places])[self._place]
        self._used = (self._actions[:, :, 0] > 0).sum(axis=1)
        # The time for which the object slides on, in actions.
        self._roll = rolling[good, 0] / body.horizon
        # The pusher's way from its end of each push to each place, in actions.
        pusher = rotated(pusher[good] - self._rest[:, :2], -self._rest[:, 2])
        self._between = detours.lengths(pusher, self._starts) / self._longest

    def __len__(self) -> int:
        return len(self._place)

    def choose(
        self,
        rest: np.ndarray,
        p: np.ndarray,
        goal: np.ndarray,
        scales: np.ndarray,
        waiting: float,
        barren: int | None = None,
    ) -> list[Choice]:
        """Return the best pushes for an object that comes to rest at a pose.

        Args:
            rest: (3) m and rad, pose of B at rest.
            p: (2) m, world: position of the pusher.
            goal: (3) m and rad, pose of B at the goal.
            scales: (3) m and rad, tolerances: the units of the errors.
            waiting: Number of actions until the object rests.
            barren: Index of an edge at which not to push first; None for none.

        Returns:
            Some choices, the best first, no two of which push at the same edges.
        """
        seen = rotated(p - rest[:2], -rest[2])
        there = self._detours.lengths(seen[None], self._starts)[0] / self._longest
        place = rest[:2] + rotated(self._starts, rest[2])
        there = there + _NO_CHOICE * ((place < self._low) | (place > self._high)).any(axis=1)
        begin = np.maximum(np.ceil(there), waiting)[self._place] + self._used
        begin += _NO_CHOICE * (self._edge == (-1 if barren is None else barren))
        # The goal, seen from the object.
        target = np.concatenate(
            [rotated(goal[:2] - rest[:2], -rest[2]), [math.remainder(goal[2] - rest[2], 2 * math.pi)]]
        )
        single = begin + self._roll
        now = _norm(target / scales)
        one = single + missed_cost(_norm((self._rest - target) / scales), now)
        # First pushes k, and then j: pose k * pose j.
        c, s = np.cos(self._rest[:, 2]), np.sin(self._rest[:, 2])
        x, y = self._rest[:, 0], self._rest[:, 1]
        error = np.empty((len(self), len(self), 3))
        error[..., 0] = x[:, None] + np.outer(c, x) - np.outer(s, y) - target[0]
        error[..., 1] = y[:, None] + np.outer(s, x) + np.outer(c, y) - target[1]
        error[..., 2] = self._rest[:, None, 2] + self._rest[:, 2] - target[2]
        wait = np.maximum(np.ceil(self._between), self._roll[:, None])[:, self._place]
        both = begin[:, None] + wait + self._used + self._roll
        two = both + missed_cost(_norm(error / scales), now)
        edges, best = set(), int(np.argmin(one))
        found = [Choice((self._push(best), PlannedPush.none()), float(one[best]), float(single[best]))]
        edge, count = self._edge, min(_CANDIDATES, two.size)
        order = np.argpartition(two.ravel(), count - 1)[:count]
        for index in order[np.argsort(two.ravel()[order])]:
            k, j = (int(i) for i in np.unravel_index(index, two.shape))
            if (edge[k], edge[j]) in edges:
                continue
            edges.add((edge[k], edge[j]))
            found.append(Choice((self._push(k), self._push(j)), float(two[k, j]), float(both[k, j])))
            if len(edges) == _CHOICES:
                break
        return sorted(found, key=lambda choice: choice.actions)[:_CHOICES]

    def _push(self, row: int) -> PlannedPush:
        edge, along = self._places[self._place[row]]
        return PlannedPush(edge, along, self._actions[row].copy())


def missed_cost(miss: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Return the number of actions, roughly, to mend errors; those that are not clearly smaller than now cost much.

    Args:
        miss: (...) norms of the errors that are left, in tolerances.
        now: (...) norm of the present error, in tolerances.
    """
    cost: np.ndarray = _MISSED * np.minimum(miss**2, 1.0) + _FAR * np.maximum(miss - 1.0, 0.0)
    cost += _NO_CHOICE * (miss > _GAIN * now)
    return cost


def _norm(error: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", error, error)))
