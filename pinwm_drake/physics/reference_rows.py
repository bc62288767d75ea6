# SPDX-License-Identifier: MIT
"""Contacts and joints of the torch reference.

Features are selected by the narrow phase on the CPU (a discrete choice without gradient); contact geometry and joints
are dense torch code on the device of their inputs, differentiated by autograd.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.errors import SolverError
from pinwm_drake.geometry.features_torch import POINT, contacts_from_features, tangent_frames
from pinwm_drake.geometry.pieces import IF_FLAT, IF_LYING
from pinwm_drake.physics.kernels.arrays import ANGULAR_HINGE, LINEAR
from pinwm_drake.physics.kernels.recorded import select_worlds
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters, kernel_arrays
from pinwm_drake.physics.state import State
from pinwm_drake.spatial.rotations import quaternion_to_matrix


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts of W worlds, padded to C; padded ones are not `valid`."""

    valid: Tensor  # (W, C)
    body: Tensor  # (W, C, 2), bodies A and B: dynamic, then the pusher, then the world
    pair: Tensor  # (W, C), column of the pair parameters
    gap: Tensor  # (W, C), m
    frame: Tensor  # (W, C, 3, 3), rows nhat_BA_W, t1, t2
    J: Tensor  # (W, C, 3, 6 nb), relative velocity in the contact frame per velocity of the dynamic bodies
    J_P: Tensor  # (W, C, 3, 6), the same per velocity of the pusher


def skew(v: Tensor) -> Tensor:
    """Return matrices (..., 3, 3) of cross products with v (..., 3)."""
    return torch.linalg.cross(v[..., None, :], torch.eye(3).to(v).expand(*v.shape, 3)).mT


class Features(NamedTuple):
    """Feature pairs of W worlds, padded to C."""

    valid: np.ndarray  # (W, C)
    rows: np.ndarray  # (W, C, 16)
    body: np.ndarray  # (W, C, 2)
    pair: np.ndarray  # (W, C)

    def of(self, worlds: Tensor) -> "Features":
        """Return those of some worlds, given by their numbers (n,)."""
        chosen = worlds.cpu().numpy()
        return Features(*(values[chosen] for values in self))


def select_features(model: Model, parameters: Parameters, state: State, V_WP: Tensor, h: Tensor) -> Features:
    """Features that parts of length h (W,) from a state may bring together, selected on the CPU."""
    arrays = kernel_arrays(parameters, V_WP[None], (tensor[None] for tensor in state.tensors()))
    count, rows, body, pair = select_worlds(model.arrays, *arrays, model.contact_rows, h.detach().cpu().numpy())
    if int(count.max()) > model.max_contacts:
        raise SolverError(
            f"world {int(count.argmax())}: more than {model.max_contacts} contacts; raise max_contacts of the model"
        )
    C = max(int(count.max()), 1)
    return Features(np.arange(C) < count[:, None], rows[:, :C].copy(), body[:, :C].copy(), pair[:, :C].copy())


def find_contacts(model: Model, parameters: Parameters, features: Features, state: State) -> Contacts:
    """Compute the geometry of features at a state of W worlds."""
    device = state.p_WP.device
    W, nb = state.num_worlds, model.num_bodies
    R = rotations(state)
    valid, rows_t, body_t, pair_t = (torch.from_numpy(values).to(device) for values in features)
    # Padding must not produce NaN gradients: a harmless point above the floor.
    harmless = torch.zeros(16, dtype=rows_t.dtype, device=device)
    harmless[8], harmless[14] = 2.0, 1.0
    rows_t = torch.where(valid[..., None], rows_t, harmless)
    body_t = torch.where(valid[..., None], body_t, torch.tensor([0, nb + 1], device=device))
    world = torch.arange(W, device=device)[:, None]
    rows_t = _placed(model, parameters, rows_t, body_t, valid, world)
    zero = torch.zeros(W, 1, 3, dtype=R.dtype, device=device)
    p = torch.cat([state.p_WB, state.p_WP[:, None], zero], 1)
    A, B = body_t[..., 0], body_t[..., 1]
    gap, n, a, b = contacts_from_features(rows_t, R[world, A], p[world, A], R[world, B], p[world, B])
    gap = gap - torch.gather(parameters.offset, 1, pair_t)
    frame = tangent_frames(n)
    point = 0.5 * (a + b)
    J_all = torch.zeros(W, rows_t.shape[1], nb + 2, 3, 6, dtype=R.dtype, device=device)
    for side, sign in ((A, 1.0), (B, -1.0)):
        lever = point - p[world, side]
        block = sign * torch.cat([-frame @ skew(lever), frame], -1)
        J_all = J_all + torch.nn.functional.one_hot(side, nb + 2).to(R.dtype)[..., None, None] * block[:, :, None]
    J = J_all[:, :, :nb].movedim(2, 3).flatten(-2)
    return Contacts(valid, body_t, pair_t, gap, frame, J, J_all[:, :, nb])


def _placed(model: Model, parameters: Parameters, rows: Tensor, body: Tensor, valid: Tensor, world: Tensor) -> Tensor:
    """Rows (W, C, 16) whose points follow centres of mass and spreads of pressure, as far as derivatives go."""
    nb, table = model.num_bodies, model.arrays.table

    def constant(values: np.ndarray) -> Tensor:
        return torch.as_tensor(values, device=rows.device)

    still = rows.new_zeros(len(rows), 2, 3)
    center = torch.cat([parameters.center - parameters.center.detach(), still], 1)
    change = torch.cat([parameters.spread - parameters.spread.detach(), still], 1)[world, body[..., 0]]
    fixed = valid & (body[..., 1] == nb + 1) & (rows[..., 0] == POINT) & (rows[..., 4] >= 0.0)
    number = torch.where(fixed, rows[..., 4], torch.zeros_like(rows[..., 4])).long()
    owner = constant(table.floor_owners)[number]
    n, x = constant(table.floor_faces)[number], constant(table.floor_points)[number][..., :3]
    lying, along = (owner == IF_LYING)[..., None], n * (n * x).sum(-1, keepdim=True)
    moved = change * torch.where(lying, along, x - along)
    along = n * (n * moved).sum(-1, keepdim=True)
    fixed = fixed & ((owner == IF_FLAT) | (owner == IF_LYING))
    moved = torch.where(fixed[..., None], torch.where(lying, along, moved - along), torch.zeros_like(moved))
    A, B = rows[..., 1:4] - center[world, body[..., 0]] + moved, rows[..., 9:12] - center[world, body[..., 1]]
    return torch.cat([rows[..., :1], A, rows[..., 4:9], B, rows[..., 12:]], -1)


def joint_rows(model: Model, state: State, R: Tensor, V_WP: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Joint rows: Jacobian J_e (W, nr, 6 nb), bias_e (W, nr) and position error error_e (W, nr)."""
    arrays, nb = model.arrays, model.num_bodies
    p = torch.cat([state.p_WB, state.p_WP[:, None], torch.zeros_like(state.p_WP)[:, None]], 1)
    (A, B), kind = (torch.as_tensor(rows, device=R.device) for rows in (arrays.joint_bodies.T, arrays.joint_kind))

    def turned(body: Tensor, vectors: np.ndarray) -> Tensor:
        return (R[:, body] @ torch.as_tensor(vectors, device=R.device)[..., None])[..., 0]

    d = turned(B, arrays.joint_direction)
    u_A, u_B = turned(A, arrays.joint_anchor[:, 0]), turned(B, arrays.joint_anchor[:, 1])
    linear = (kind == LINEAR)[:, None]
    rows = R.new_zeros(len(R), len(kind), nb + 2, 6)
    for body, sign, u in ((A, 1.0, u_A), (B, -1.0, u_B)):
        arm, push = torch.where(linear, torch.linalg.cross(u, d), d), torch.where(linear, d, torch.zeros_like(d))
        hot = torch.nn.functional.one_hot(body, nb + 2).to(R.dtype)
        rows = rows + sign * hot[..., None] * torch.cat([arm, push], -1)[:, :, None]
    E = R[:, A] @ torch.as_tensor(arrays.joint_rotation, device=R.device).mT @ R[:, B].mT
    turn = torch.stack([E[..., 2, 1] - E[..., 1, 2], E[..., 0, 2] - E[..., 2, 0], E[..., 1, 0] - E[..., 0, 1]], -1)
    error = torch.where((kind == ANGULAR_HINGE)[:, None], torch.linalg.cross(u_B, u_A), 0.5 * turn)
    error = torch.where(linear, p[:, A] + u_A - p[:, B] - u_B, error)
    return rows[:, :, :nb].flatten(2), (rows[:, :, nb] @ V_WP[..., None])[..., 0], (d * error).sum(-1)


def joint_error(model: Model, state: State) -> Tensor:
    """Largest position error of each joint's rows (W, number of joints), m or rad."""
    W = state.num_worlds
    _, _, errors = joint_rows(model, state.detach(), rotations(state.detach()), torch.zeros(W, 6).to(state.p_WP))
    rows = [len(model.joint_rows(joint)) for joint in model.joints]
    return torch.stack([part.abs().amax(-1) for part in errors.split(rows, -1)], -1)


def rotations(state: State) -> Tensor:
    """Rotations (W, nb + 2, 3, 3) of the bodies, the pusher and the world."""
    eye3 = torch.eye(3).to(state.q_WB).expand(state.num_worlds, 1, 3, 3)
    return torch.cat([quaternion_to_matrix(state.q_WB), quaternion_to_matrix(state.q_WP)[:, None], eye3], 1)
