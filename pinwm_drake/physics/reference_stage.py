# SPDX-License-Identifier: MIT
"""The equations of a stage of a step in the torch reference; see `kernels/step.py` for what they are."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pinwm_drake.errors import SolverError
from pinwm_drake.geometry.pieces import CYLINDER
from pinwm_drake.physics.cone import ContactProblem, solve
from pinwm_drake.physics.kernels.detect import LEAST_REBOUND, SLOW
from pinwm_drake.physics.kernels.dynamics import IMPACT, POSITION, VELOCITY
from pinwm_drake.physics.kernels.rolling import LEVER, MOST_LEVER, RESTS
from pinwm_drake.physics.kernels.stabilise import SLOP
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.reference_rows import Contacts, Features, find_contacts, joint_rows, rotations, skew
from pinwm_drake.physics.state import State
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_multiply

_GYROSCOPIC_STEPS = 8


def move(state: State, V: Tensor, V_WP: Tensor, h: Tensor, delta: Tensor | float = 0.0) -> State:
    """Return the state with poses after a time h (W,), and a correction, and with velocities V (W, nb, 6)."""
    turn, shift = (h[:, None, None] * V + delta).split(3, -1)
    q = quaternion_multiply(quaternion_exp(turn), state.q_WB)
    q_WP = quaternion_multiply(quaternion_exp(h[:, None] * V_WP[:, :3]), state.q_WP)
    return State(q / q.norm(dim=-1, keepdim=True), state.p_WB + shift, V, q_WP, state.p_WP + h[:, None] * V_WP[:, 3:])


def _gyroscopic_step(I_B: Tensor, w0: Tensor, h: Tensor) -> Tensor:
    """Solves I_B (w - w0) + h w x I_B w = 0 (body frame) by Newton's method; the last step carries the gradient."""

    def residual(w: Tensor) -> Tensor:
        return (I_B @ (w - w0)[..., None])[..., 0] + h[:, None, None] * torch.linalg.cross(
            w, (I_B @ w[..., None])[..., 0]
        )

    def jacobian(w: Tensor) -> Tensor:
        return I_B + h[:, None, None, None] * (skew(w) @ I_B - skew((I_B @ w[..., None])[..., 0]))

    with torch.no_grad():
        w = w0
        for _ in range(_GYROSCOPIC_STEPS):
            w = w - torch.linalg.solve(jacobian(w), residual(w))
        J = jacobian(w)
    return w - torch.linalg.solve(J, residual(w))


@dataclass(frozen=True, eq=False)
class Stage:
    """Equations of a stage of W worlds; `away` are contacts that are left out (W, C)."""

    problem: ContactProblem
    contacts: Contacts
    joints: tuple[Tensor, Tensor]  # J_e and error_e
    free: Tensor  # (W, 6 nb), velocity without contacts and joints
    closed: Tensor  # (W, C)
    strikes: Tensor  # (W, C), what touches and closes
    bent: Tensor  # (W, C), error by levers that turn, m/s

    def solve(self, away: Tensor | None = None) -> Tensor:
        """Solution x (W, n), without contacts that are away."""
        problem = self.problem
        if away is not None:
            problem = replace(
                problem,
                J=torch.where(away[..., None, None], torch.zeros_like(problem.J), problem.J),
                bias=torch.where(away[..., None], torch.ones_like(problem.bias), problem.bias),
            )
        x, found = solve(problem, torch.nn.functional.pad(self.free, (0, problem.p.shape[-1] - self.free.shape[-1])))
        if not bool(found.all()):
            worlds = tuple(torch.nonzero(~found)[:, 0].tolist())
            raise SolverError(f"world {worlds[0]}: the contacts have no solution", worlds=worlds)
        return x

    def impulse(self, x: Tensor) -> Tensor:
        """Normal impulses (W, C) of a solution."""
        return self.problem.contact_impulse(self.problem.velocity(x.detach()))[..., 0]


def _free(model: Model, parameters: Parameters, state: State, h: Tensor, stage: int) -> Tensor:
    """Velocity (W, 6 nb) without contacts: half of gravity and of the gyroscopic torque."""
    half = 0.5 * h
    R_WB = rotations(state)[:, : model.num_bodies]
    w = (R_WB.mT @ state.V_WB[..., :3, None])[..., 0]
    I_B = parameters.inertia
    if stage == POSITION:
        w = _gyroscopic_step(I_B, w, half)
    else:
        torque = torch.linalg.cross(w, (I_B @ w[..., None])[..., 0])
        w = w - half[:, None, None] * torch.linalg.solve(I_B, torque)
    gravity = torch.as_tensor(model.arrays.gravity, dtype=w.dtype, device=w.device)
    return torch.cat([(R_WB @ w[..., None])[..., 0], state.V_WB[..., 3:] + half[:, None, None] * gravity], -1).flatten(
        1
    )


def _rolling_torque(model: Model, parameters: Parameters, state: State) -> Tensor:
    """Torques (W, nb, 3) of rolling friction at rims that rest on the floor; see `kernels/rolling.py`."""
    R, g, torques = rotations(state), -float(model.arrays.gravity[2]), []
    for b, body in enumerate(model.bodies):
        torque = torch.zeros_like(state.V_WB[:, b, :3])
        free = torch.ones_like(torque[:, :1], dtype=torch.bool)
        rolls = model.arrays.pair_index[b, -1] >= 0 and g > 0.0
        for piece in (piece for piece in body.pieces if rolls and piece.kind == CYLINDER):
            ends = torch.as_tensor(piece.vertices).to(torque)
            up = R[:, b, 2]
            axis = R[:, b] @ ((ends[1] - ends[0]) / (ends[1] - ends[0]).norm())
            heights = (up[:, None] * (ends - parameters.center[:, None, b])).sum(-1).amin(-1, keepdim=True)
            lowest = state.p_WB[:, b, 2:] + heights - piece.radius * axis[:, :2].norm(dim=-1, keepdim=True)
            rests = free & (lowest.detach() - (model.floor_height or 0.0) <= RESTS)
            lever = min(LEVER, MOST_LEVER * piece.radius)
            slow = 4.0 * lever * g * model.time_step / piece.radius**2
            w = torch.nn.functional.pad(state.V_WB[:, b, :2], (0, 1))
            weight = lever * g * parameters.mass[:, b, None] * axis[:, 2:] ** 2
            torque = torque - torch.where(rests, weight * w / (w.square().sum(-1, keepdim=True) + slow**2).sqrt(), 0.0)
            free = free & ~rests
        torques.append(torque)
    return torch.stack(torques, 1)


def _velocities(contacts: Contacts, V: Tensor, V_WP: Tensor) -> Tensor:
    """Velocities (W, C, 3) of contacts in their frames, of bodies V (W, 6 nb) and the pusher."""
    return (contacts.J @ V[:, None, :, None] + contacts.J_P @ V_WP[:, None, :, None])[..., 0]


def _curve(
    model: Model, parameters: Parameters, features: Features, state: State, V_WP: Tensor, h: Tensor, now: Contacts
) -> Tensor:
    """Change (W, C, 3) of the contacts' velocities by levers and normals that turn, until half of a step."""
    V = state.V_WB.flatten(1)
    then = find_contacts(model, parameters, features, move(state, state.V_WB, V_WP, 0.5 * h))
    v, v_then = _velocities(now, V, V_WP), _velocities(then, V, V_WP)
    change = (then.frame.mT @ v_then[..., None] - now.frame.mT @ v[..., None])[..., 0]
    across = (now.frame[:, :, 1:] @ change[..., None])[..., 0]
    return torch.cat([(v_then - v)[..., :1], across], -1)


def build_stage(
    model: Model,
    parameters: Parameters,
    features: Features,
    state: State,
    V_WP: Tensor,
    h: Tensor,
    stage: int,
    takes_part: Tensor | None = None,
) -> Stage:
    """Equations of a stage of parts of length h (W,), from velocities in the state.

    Args:
        model: the scene.
        parameters: theta.
        features: those of the part's start.
        state: at the start for the POSITION stage, else where the VELOCITY stage or IMPACT is.
        V_WP: (W, 6).
        h: (W,), s.
        stage: which one.
        takes_part: (W, C), for the VELOCITY stage.
    """
    H, nb, W, arrays = model.time_step, model.num_bodies, state.num_worlds, model.arrays
    dtype, device = state.p_WB.dtype, state.p_WB.device
    free = _free(model, parameters, state, h, stage)
    R = rotations(state)
    inertia = R[:, :nb] @ parameters.inertia @ R[:, :nb].mT
    M = torch.zeros(W, 6 * nb, 6 * nb, dtype=dtype, device=device)
    for b in range(nb):
        M[:, 6 * b : 6 * b + 3, 6 * b : 6 * b + 3] = inertia[:, b]
        M[:, 6 * b + 3 : 6 * b + 6, 6 * b + 3 : 6 * b + 6] = parameters.mass[:, b, None, None] * R[:, -1]
    torque = torch.nn.functional.pad(_rolling_torque(model, parameters, state), (0, 3)).flatten(1)
    momentum = (M @ free[..., None])[..., 0] + 0.5 * h[:, None] * torque

    contacts = find_contacts(model, parameters, features, state)
    gap, bias = contacts.gap, (contacts.J_P @ V_WP[:, None, :, None])[..., 0]
    closed = contacts.valid & (gap <= SLOW * H)
    e = torch.gather(parameters.restitution, 1, contacts.pair)
    approach = _velocities(contacts, state.V_WB.flatten(1), V_WP)[..., 0]
    gravity = torch.as_tensor(arrays.gravity, dtype=dtype, device=device)
    falls = -H * (contacts.frame[:, :, 0] @ gravity).clamp_max(0.0) * (contacts.body[..., 1] >= nb)
    strikes = closed & (approach < -SLOW)
    bounces = closed & (approach < 0.0) & (-e * approach + LEAST_REBOUND > falls)
    rebound = torch.where(bounces, -e * approach, torch.zeros_like(approach))
    if stage == POSITION:
        active = contacts.valid
        h_ = h[:, None]
        drift = torch.where(gap > 0.0, gap / h_, gap.clamp_min(-SLOP) / H)
        curve = _curve(model, parameters, features, state, V_WP, h, contacts)
        bias = bias + curve
        zero = torch.zeros_like(V_WP[:, :3])
        spin = torch.stack([*state.V_WB[..., :3].unbind(1), V_WP[:, :3], zero], 1).norm(dim=-1)
        turn = torch.gather(spin, 1, contacts.body.flatten(1)).unflatten(1, contacts.body.shape[1:]).amax(-1)
        bent = (h_ * turn * curve.norm(dim=-1)).detach()
    else:
        bent = torch.zeros_like(gap)
        active = closed if takes_part is None else contacts.valid & takes_part
        drift = gap.clamp(-SLOP, 0.0) / H
        if stage == IMPACT:
            drift = drift - rebound
    bias = torch.cat([(bias[..., 0] + drift)[..., None], bias[..., 1:]], -1)

    pressing = contacts.body[..., 1] == nb
    same = (contacts.body[:, :, None] == contacts.body[:, None]).all(-1) & contacts.valid[:, None]
    sharing = (pressing[:, :, None] & same).sum(-1)
    force = 0.5 * h[:, None] * arrays.pusher_force / sharing.clamp_min(1)
    if stage != VELOCITY:
        force = force + torch.as_tensor(arrays.impact_impulse, dtype=dtype, device=device)[contacts.body[..., 0]]
    limit = torch.where(pressing, force, torch.full_like(force, torch.inf))

    J_e, bias_e, error_e = joint_rows(model, state, R, V_WP)
    nr = J_e.shape[1]
    eye_e = arrays.joint_compliance * torch.eye(nr, dtype=dtype, device=device).expand(W, nr, nr)
    with torch.no_grad():
        rates = (contacts.J @ free[:, None, :, None])[..., 0].abs().amax(-1)
        rates = torch.maximum(rates, bias.abs().amax(-1))
        speed = torch.where(active, rates, torch.zeros_like(rates)).amax(-1)
        speed = torch.maximum(speed, free.unflatten(1, (nb, 6))[..., 3:].abs().flatten(1).amax(-1)).clamp_min(1e-6)
    problem = ContactProblem(
        A=torch.cat([torch.cat([M, -J_e.mT], -1), torch.cat([J_e, eye_e], -1)], -2),
        p=torch.cat([momentum, -bias_e], -1),
        J=torch.nn.functional.pad(torch.where(active[..., None, None], contacts.J, 0.0 * contacts.J), (0, nr)),
        # What takes no part is open, whatever moves.
        bias=torch.where(active[..., None], bias, torch.ones_like(bias)),
        mu=torch.gather(parameters.friction, 1, contacts.pair),
        limit=limit,
        compliance=arrays.contact_compliance,
        impulse=parameters.mass.detach().sum(-1) * speed,
    )
    return Stage(problem, contacts, (J_e, error_e), free, closed, strikes, bent)
