# SPDX-License-Identifier: MIT
"""Kicks: what errors of the law of contact make of a motion, where the dynamics carries them on.

A hit or a slide changes the object's velocity. Laws of contact differ in that change by some share of it, and a motion
that goes on without the pusher, such as that of a mug that whirls on its rim, makes more and more of a small
difference. So in parts of the motion each component of the change of velocity is off by an error of its own, whose
standard deviation is a share of the component. `carried_kicks` returns what such errors do to the poses: a root of a
further covariance of poses beside that of `drift.py`. A pusher that stays at the object, or friction that stops
it, takes kicks back: pushes hardly have any.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.errors import SolverError
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
) -> Tensor:
    """Deviations of the poses of a push by an error of each change of velocity that is as large as the change.

    Arguments are those of `scene.rollout_poses`, of one world and n times.

    Returns:
        (6n, 6m), m parts: frame by frame rotation vector [rad] and position [m]. None of a part, m = 0, where nothing
        moves or the physics has no solution.
    """
    n, h = len(after), scene.model.time_step
    start, V_WP = start_state(scene, parameters, X_WO, motion, V_WO)
    stepper = Stepper(scene.model, num_threads=num_threads)
    columns = []
    try:
        record = stepper.rollout(parameters, start, V_WP)
        for step, change in _changes(record, scene.model):
            later = torch.nonzero(after > step * h)[:, 0]
            kicks = torch.cat([_SHARE * torch.diag(change), -_SHARE * torch.diag(change)])
            many = parameters.expand(len(kicks))
            kicked = stepper.rollout(many, _kicked(record, step, kicks), V_WP[step:].expand(-1, len(kicks), 6))
            X = poses_at(scene, many, kicked, after[later] - step * h)
            (q, q_back), (p, p_back) = X.q.unflatten(1, (2, 6)).unbind(1), X.p.unflatten(1, (2, 6)).unbind(1)
            moved = torch.cat([turn_between(q_back, q), p - p_back], -1) / (2.0 * _SHARE)
            column = torch.zeros(n, 6, 6, dtype=torch.float64)
            column[later] = moved.transpose(1, 2)
            columns.append(column.reshape(6 * n, 6))
    except SolverError:
        columns = []
    return torch.cat([torch.zeros(6 * n, 0, dtype=torch.float64), *columns], -1)


def _changes(record: Trajectory, model: Model) -> Iterator[tuple[int, Tensor]]:
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
