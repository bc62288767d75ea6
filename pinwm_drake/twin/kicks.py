# SPDX-License-Identifier: MIT
"""Kicks: what errors of the law of contact make of a motion, where the dynamics carries them on.

A hit or a slide changes the object's velocity. Laws of contact differ in that change by some share of it, and a motion
that goes on without the pusher, such as that of a mug that whirls on its rim, makes more and more of a small
difference. So in parts of the motion each component of the change of velocity is off by an error of its own, whose
standard deviation is a share of the component. A hit has a larger error, in any direction: bodies that give way go on
to slip and to turn while they hit, and rigid ones do not. `carried_kicks` returns what such errors do to the poses:
roots of a further covariance of poses beside that of `drift.py`. A pusher that stays at the object, or friction that
stops it, takes kicks back: pushes hardly have any.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.errors import SolverError
from pinwm_drake.geometry.meshes import half_diagonal
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State, Trajectory
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.scene import PusherMotion, Scene, poses_at, start_state
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import turn_between

# Parts of a motion, and the velocity from which on the object moves, rad/s and m/s.
_PARTS, _RESTS = 12, 1e-3
# Errors that are tried, as a share of a change of velocity.
_SHARE = 0.03
# Error of what sliding changes, as a share of it, for a drift of one metre in a metre; and of what a hit changes, in
# each direction.
PER_WALK, OF_HITS = 0.5, 0.04
# A hit changes a velocity, or that of the rim, by more in a step than gravity by this factor; hits that count.
_HITS, _MOST_HITS = 5.0, 4


@dataclass(frozen=True, eq=False)
class Kicks:
    """What errors of changes of velocity make of the poses of a push, frame by frame rotation vector and position.

    Attributes:
        slides: (6n, m) [rad; m], by errors as large as what slides and turns change; one column a part and component.
        hits: (6n, k) [rad; m], by errors as large as what hits change, in any direction.
    """

    slides: Tensor
    hits: Tensor

    def root(self, walk: float) -> Tensor:
        """Root (6n, m + k) of their covariance, at a drift [m] after a way of one metre."""
        return torch.cat([PER_WALK * walk * self.slides, OF_HITS * self.hits], -1)


@torch.no_grad()
def carried_kicks(
    scene: Scene,
    parameters: Parameters,
    X_WO: Pose,
    motion: PusherMotion,
    after: Tensor,
    *,
    V_WO: Tensor | None = None,
    num_threads: int | None = None,
) -> Kicks:
    """Deviations of the n poses of a push by errors of its changes of velocity.

    Arguments are those of `scene.rollout_poses`, of one world and n times.

    Returns:
        (6n, m) and (6n, k): frame by frame rotation vector [rad] and position [m]. None, m = k = 0, where nothing moves
        or the physics has no solution.
    """
    start, V_WP = start_state(scene, parameters, X_WO, motion, V_WO)
    stepper, columns = Stepper(scene.model, num_threads=num_threads), []
    try:
        record = stepper.rollout(parameters, start, V_WP)
        for changes in (_slides(record, scene.model), _hits(record, scene)):
            moved = [_moved(scene, stepper, parameters, record, V_WP, after, *one) for one in changes]
            columns.append(torch.cat([torch.zeros(6 * len(after), 0, dtype=torch.float64), *moved], -1))
    except SolverError:
        columns = [torch.zeros(6 * len(after), 0, dtype=torch.float64)] * 2
    return Kicks(*columns)


def _moved(
    scene: Scene,
    stepper: Stepper,
    parameters: Parameters,
    record: Trajectory,
    V_WP: Tensor,
    after: Tensor,
    step: int,
    change: Tensor,
) -> Tensor:
    """Return what an error as large as a change of velocity (6,) at a step makes of the poses (6n, 6)."""
    h = scene.model.time_step
    later = torch.nonzero(after > step * h)[:, 0]
    kicks = torch.cat([_SHARE * torch.diag(change), -_SHARE * torch.diag(change)])
    many = parameters.expand(len(kicks))
    kicked = stepper.rollout(many, _kicked(record, step, kicks), V_WP[step:].expand(-1, len(kicks), 6))
    X = poses_at(scene, many, kicked, after[later] - step * h)
    (q, q_back), (p, p_back) = X.q.unflatten(1, (2, 6)).unbind(1), X.p.unflatten(1, (2, 6)).unbind(1)
    moved = torch.cat([turn_between(q_back, q), p - p_back], -1) / (2.0 * _SHARE)
    column = torch.zeros(len(after), 6, 6, dtype=torch.float64)
    column[later] = moved.transpose(1, 2)
    return column.reshape(-1, 6)


def _hits(record: Trajectory, scene: Scene) -> list[tuple[int, Tensor]]:
    """Steps after the strongest hits, and how much (6,) these change turns [rad/s] and places [m/s], whichever way."""
    V, radius = record.V_WB[:, 0, 0].numpy(), half_diagonal(scene.mesh)
    size = _strength(np.diff(V, axis=0), radius)
    steps = np.nonzero(size > _HITS * scene.model.time_step * np.linalg.norm(scene.model.gravity))[0]
    hits = [(one[0], one[-1] + 1) for one in np.split(steps, np.nonzero(np.diff(steps) > 1)[0] + 1) if len(one)]
    hits = [(first, last) for first, last in hits if last < len(V) - 1]
    hits.sort(key=lambda one: -float(_strength(V[one[1]] - V[one[0]], radius)))
    found = []
    for first, last in sorted(hits[:_MOST_HITS]):
        turn, place = np.linalg.norm((V[last] - V[first]).reshape(2, 3), axis=1)
        found.append((int(last), torch.tensor([turn] * 3 + [place] * 3, dtype=torch.float64)))
    return found


def _strength(change: np.ndarray, radius: float) -> np.ndarray:
    """Return the larger one of the changes of the velocities of place and rim [m/s], of changes (..., 6)."""
    rim = radius * np.linalg.norm(change[..., :3], axis=-1)
    return np.maximum(rim, np.linalg.norm(change[..., 3:], axis=-1))


def _slides(record: Trajectory, model: Model) -> Iterator[tuple[int, Tensor]]:
    """Steps at which parts of a motion end, and the changes of velocity (6,) [rad/s; m/s] by contact in these parts."""
    V = record.V_WB[:, 0, 0]
    moving = torch.nonzero(V.norm(dim=-1) > _RESTS)[:, 0].tolist()
    if not moving:
        return
    ends = np.linspace(max(moving[0] - 1, 0), min(moving[-1], len(V) - 2), _PARTS + 1).round().astype(int)
    gravity = torch.tensor([0.0, 0.0, 0.0, *model.gravity], dtype=torch.float64)
    for first, last in pairwise(np.unique(ends).tolist()):
        change = V[last] - V[first]
        # In the air gravity alone changes the velocity, and what lies or slides does not fall.
        fallen = change - (last - first) * model.time_step * gravity
        yield last, torch.where(change.abs() < fallen.abs(), change, fallen)


def _kicked(record: Trajectory, step: int, kicks: Tensor) -> State:
    """Return W states as the one world of a record is at a step, with kicks (W, 6) to the object."""
    W = len(kicks)
    return State(
        q_WB=record.q_WB[step].expand(W, 1, 4),
        p_WB=record.p_WB[step].expand(W, 1, 3),
        V_WB=record.V_WB[step, 0] + kicks[:, None],
        q_WP=record.q_WP[step].expand(W, 4),
        p_WP=record.p_WP[step].expand(W, 3),
    )
