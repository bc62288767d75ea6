# SPDX-License-Identifier: MIT
"""The step in plain torch: the oracle of the kernels, and the path that runs on CUDA.

Features are selected by the narrow phase on the CPU (a discrete choice without gradient); everything else (contact
geometry, equations, solution, stabilisation, integration) is dense torch code on the device of its inputs,
differentiated by autograd.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.errors import SolverError
from pinwm_drake.geometry.features_torch import POINT, contacts_from_features, tangent_frames
from pinwm_drake.geometry.pieces import IF_FLAT
from pinwm_drake.physics.cone import ContactProblem, solve
from pinwm_drake.physics.kernels.arrays import ANGULAR_HINGE, LINEAR
from pinwm_drake.physics.kernels.detect import FADE, LEAST_REBOUND
from pinwm_drake.physics.kernels.recorded import select_worlds
from pinwm_drake.physics.kernels.stabilise import CONTACT, KAPPA, MOST_PUSHED, ROUNDING, ROUNDS, SLOP
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters, kernel_arrays
from pinwm_drake.physics.state import State, Trajectory
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_multiply, quaternion_to_matrix

_GYROSCOPIC_STEPS = 8


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


def _skew(v: Tensor) -> Tensor:
    return torch.linalg.cross(v[..., None, :], torch.eye(3).to(v).expand(*v.shape, 3)).mT


def find_contacts(model: Model, parameters: Parameters, state: State, R: Tensor, V_WP: Tensor) -> Contacts:
    """Select features on the CPU and compute their geometry in torch.

    Args:
        model: the scene.
        state: W worlds.
        R: (W, nb + 2, 3, 3), rotations of the bodies, the pusher and the world.
        V_WP: (W, 6), pusher velocity.
    """
    device = state.p_WP.device
    W, nb = state.num_worlds, model.num_bodies
    arrays = kernel_arrays(parameters, V_WP[None], (tensor[None] for tensor in state.tensors()))
    count, rows, body, pair = select_worlds(model.arrays, *arrays, model.contact_rows)
    if int(count.max()) > model.max_contacts:
        raise SolverError(
            f"world {int(count.argmax())}: more than {model.max_contacts} contacts; raise max_contacts of the model"
        )
    C = max(int(count.max()), 1)
    valid = torch.from_numpy(np.arange(C) < count[:, None]).to(device)
    rows_t = torch.from_numpy(rows[:, :C].copy()).to(device)
    body_t = torch.from_numpy(body[:, :C].copy()).to(device)
    # Padding must not produce NaN gradients: a harmless point above the floor.
    harmless = torch.zeros(16, dtype=rows_t.dtype, device=device)
    harmless[8], harmless[14] = 2.0, 1.0
    rows_t = torch.where(valid[..., None], rows_t, harmless)
    body_t = torch.where(valid[..., None], body_t, torch.tensor([0, nb + 1], device=device))
    world = torch.arange(W, device=device)[:, None]
    pair_t = torch.from_numpy(pair[:, :C].copy()).to(device)
    rows_t = _placed(model, parameters, rows_t, body_t, valid, world)
    zero = torch.zeros(W, 1, 3, dtype=R.dtype, device=device)
    p = torch.cat([state.p_WB, state.p_WP[:, None], zero], 1)
    A, B = body_t[..., 0], body_t[..., 1]
    gap, n, a, b = contacts_from_features(rows_t, R[world, A], p[world, A], R[world, B], p[world, B])
    gap = gap - torch.gather(parameters.offset, 1, pair_t)
    frame = tangent_frames(n)
    point = 0.5 * (a + b)
    J_all = torch.zeros(W, C, nb + 2, 3, 6, dtype=R.dtype, device=device)
    for side, sign in ((A, 1.0), (B, -1.0)):
        lever = point - p[world, side]
        block = sign * torch.cat([-frame @ _skew(lever), frame], -1)
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
    fixed = valid & (body[..., 1] == nb + 1) & (rows[..., 0] == POINT)
    number = torch.where(fixed, rows[..., 4], torch.zeros_like(rows[..., 4])).long()
    fixed = fixed & (constant(table.floor_owners)[number] == IF_FLAT)
    n, x = constant(table.floor_faces)[number], constant(table.floor_points)[number][..., :3]
    moved = change * (x - n * (n * x).sum(-1, keepdim=True))
    moved = torch.where(fixed[..., None], moved - n * (n * moved).sum(-1, keepdim=True), torch.zeros_like(moved))
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
    _, _, errors = joint_rows(model, state.detach(), _rotations(state.detach()), torch.zeros(W, 6).to(state.p_WP))
    rows = [len(model.joint_rows(joint)) for joint in model.joints]
    return torch.stack([part.abs().amax(-1) for part in errors.split(rows, -1)], -1)


def _rotations(state: State) -> Tensor:
    """Rotations (W, nb + 2, 3, 3) of the bodies, the pusher and the world."""
    eye3 = torch.eye(3).to(state.q_WB).expand(state.num_worlds, 1, 3, 3)
    return torch.cat([quaternion_to_matrix(state.q_WB), quaternion_to_matrix(state.q_WP)[:, None], eye3], 1)


def _gyroscopic_step(I_B: Tensor, w0: Tensor, h: float) -> Tensor:
    """Solves I_B (w - w0) + h w x I_B w = 0 (body frame) by Newton's method; the last step carries the gradient."""

    def residual(w: Tensor) -> Tensor:
        return (I_B @ (w - w0)[..., None])[..., 0] + h * torch.linalg.cross(w, (I_B @ w[..., None])[..., 0])

    def jacobian(w: Tensor) -> Tensor:
        return I_B + h * (_skew(w) @ I_B - _skew((I_B @ w[..., None])[..., 0]))

    with torch.no_grad():
        w = w0
        for _ in range(_GYROSCOPIC_STEPS):
            w = w - torch.linalg.solve(jacobian(w), residual(w))
        J = jacobian(w)
    return w - torch.linalg.solve(J, residual(w))


def build_problem(
    model: Model, parameters: Parameters, state: State, V_WP: Tensor
) -> tuple[ContactProblem, Contacts, tuple[Tensor, Tensor], Tensor]:
    """Equations of one step: problem, contacts, joints (J_e, error_e) and the velocity without either (W, 6 nb)."""
    h, nb, W = model.time_step, model.num_bodies, state.num_worlds
    arrays = model.arrays
    dtype, device = state.p_WB.dtype, state.p_WB.device
    R = _rotations(state)
    R_WB = R[:, :nb]
    w_body = _gyroscopic_step(parameters.inertia, (R_WB.mT @ state.V_WB[..., :3, None])[..., 0], h)
    gravity = torch.as_tensor(arrays.gravity, dtype=dtype, device=device)
    free = torch.cat([(R_WB @ w_body[..., None])[..., 0], state.V_WB[..., 3:] + h * gravity], -1).flatten(1)
    inertia = R_WB @ parameters.inertia @ R_WB.mT
    M = torch.zeros(W, 6 * nb, 6 * nb, dtype=dtype, device=device)
    for b in range(nb):
        M[:, 6 * b : 6 * b + 3, 6 * b : 6 * b + 3] = inertia[:, b]
        M[:, 6 * b + 3 : 6 * b + 6, 6 * b + 3 : 6 * b + 6] = parameters.mass[:, b, None, None] * R[:, -1]
    momentum = (M @ free[..., None])[..., 0]

    contacts = find_contacts(model, parameters, state, R, V_WP)
    valid = contacts.valid
    bias = (contacts.J_P @ V_WP[:, None, :, None])[..., 0]
    approach = (contacts.J[:, :, 0] @ state.V_WB.flatten(1)[..., None])[..., 0] + bias[..., 0]
    closing = (contacts.gap + h * ((contacts.J[:, :, 0] @ free[..., None])[..., 0] + bias[..., 0]) < 0.0).to(dtype)
    e = torch.gather(parameters.restitution, 1, contacts.pair)
    mu = torch.gather(parameters.friction, 1, contacts.pair)
    keep = 1.0 - closing * (1.0 - (1.0 - e) ** FADE)
    falls = h * (contacts.frame[:, :, 0] @ gravity).clamp_max(0.0) * (contacts.body[..., 1] >= nb)
    bounces = (closing > 0.0) & (approach < 0.0) & (falls - e * approach > -LEAST_REBOUND)
    rebound = torch.where(bounces, falls * (e > 0.0) - e * approach, torch.zeros_like(approach))
    bias_n = bias[..., 0] + keep * contacts.gap.clamp_min(-SLOP) / h - rebound

    pressing = contacts.body[..., 1] == nb
    sharing = (
        pressing[:, :, None] & (contacts.body[:, :, None] == contacts.body[:, None]).all(-1) & valid[:, None]
    ).sum(-1)
    limit = torch.where(pressing, h * arrays.pusher_force / sharing.clamp_min(1), torch.full_like(mu, torch.inf))
    impact = torch.as_tensor(arrays.impact_impulse, dtype=dtype, device=device)
    limit = limit + impact[contacts.body[..., 0]]

    J_e, bias_e, error_e = joint_rows(model, state, R, V_WP)
    nr = J_e.shape[1]
    eye_e = arrays.joint_compliance * torch.eye(nr, dtype=dtype, device=device).expand(W, nr, nr)
    with torch.no_grad():
        rates = (contacts.J @ free[:, None, :, None])[..., 0].abs().amax(-1)
        rates = torch.maximum(rates, torch.cat([bias_n[..., None], bias[..., 1:]], -1).abs().amax(-1))
        speed = torch.where(valid, rates, torch.zeros_like(rates)).amax(-1)
        speed = torch.maximum(speed, free.unflatten(1, (nb, 6))[..., 3:].abs().flatten(1).amax(-1)).clamp_min(1e-6)
    problem = ContactProblem(
        A=torch.cat([torch.cat([M, -J_e.mT], -1), torch.cat([J_e, eye_e], -1)], -2),
        p=torch.cat([momentum, -bias_e], -1),
        J=torch.nn.functional.pad(contacts.J * valid[..., None, None], (0, nr)),
        # What is no contact is open, whatever moves.
        bias=torch.where(valid[..., None], torch.cat([bias_n[..., None], bias[..., 1:]], -1), torch.ones_like(bias)),
        mu=mu,
        limit=limit,
        compliance=arrays.contact_compliance,
        impulse=parameters.mass.detach().sum(-1) * speed,
    )
    return problem, contacts, (J_e, error_e), free


def _stabilise(model: Model, contacts: Contacts, full: Tensor, joints: tuple[Tensor, Tensor]) -> Tensor:
    """Position correction delta (W, 6 nb), [rad; m]; see `kernels/stabilise.py`."""
    nb = model.num_bodies
    taken = contacts.valid & ~full
    depth = -contacts.gap - SLOP
    depth = torch.where(contacts.body[..., 1] == nb, depth.clamp_max(MOST_PUSHED), depth)
    Jn = contacts.J[:, :, 0]
    J_e, error = joints
    metric = KAPPA * torch.as_tensor(model.arrays.stabilisation_weight, dtype=depth.dtype, device=depth.device)
    fixed = torch.diag(metric.repeat_interleave(3, 1).reshape(6 * nb)) + J_e.mT @ J_e
    pushes = taken & (depth > 0.0)
    if not bool(pushes.any()) and not model.joints:
        return torch.zeros_like(Jn[:, 0])
    for _ in range(ROUNDS):
        some = CONTACT * pushes.to(depth.dtype)
        right = (Jn.mT @ (some * depth)[..., None] - J_e.mT @ error[..., None])[..., 0]
        delta = torch.linalg.solve(fixed + Jn.mT @ (some[..., None] * Jn), right)
        left = depth - (Jn @ delta[..., None])[..., 0]
        again = taken & (left > torch.where(pushes, -ROUNDING, ROUNDING))
        if bool((again == pushes).all()):
            break
        pushes = again
    return delta


def step_reference(model: Model, parameters: Parameters, state: State, V_WP: Tensor) -> State:
    """Discrete update by one step of all worlds; see `Stepper.step`."""
    h, nb = model.time_step, model.num_bodies
    problem, contacts, joints, free = build_problem(model, parameters, state, V_WP)
    x, found = solve(problem, torch.nn.functional.pad(free, (0, problem.p.shape[-1] - free.shape[-1])))
    if not bool(found.all()):
        worlds = tuple(torch.nonzero(~found)[:, 0].tolist())
        raise SolverError(f"world {worlds[0]}: the contacts have no solution", worlds=worlds)
    V = x[:, : 6 * nb].unflatten(1, (nb, 6))
    full = problem.contact_impulse(problem.velocity(x.detach()))[..., 0] >= problem.limit
    delta = _stabilise(model, contacts, full, joints).unflatten(1, (nb, 6))
    q = quaternion_multiply(quaternion_exp(h * V[..., :3] + delta[..., :3]), state.q_WB)
    return State(
        q_WB=q / q.norm(dim=-1, keepdim=True),
        p_WB=state.p_WB + h * V[..., 3:] + delta[..., 3:],
        V_WB=V,
        q_WP=quaternion_multiply(quaternion_exp(h * V_WP[:, :3]), state.q_WP),
        p_WP=state.p_WP + h * V_WP[:, 3:],
    )


def rollout_reference(
    model: Model, parameters: Parameters, state: State, V_WP: Tensor, record_every: int
) -> Trajectory:
    """Rollout over a sequence of steps; see `Stepper.rollout`."""
    frames = [state]
    for t in range(V_WP.shape[0]):
        try:
            state = step_reference(model, parameters, state, V_WP[t])
        except SolverError as error:
            raise SolverError(f"step {t}: {error}") from error
        if (t + 1) % record_every == 0:
            frames.append(state)
    return Trajectory(*(torch.stack([getattr(f, name) for f in frames]) for name in State.__dataclass_fields__))
