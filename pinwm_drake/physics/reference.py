# SPDX-License-Identifier: MIT
"""The step in plain torch: the oracle of the kernels, and the path that runs on CUDA.

Equations, solutions, stabilisation and integration are dense torch code on the device of its inputs, differentiated by
autograd; see `kernels/step.py` for what they are, and `reference_rows.py` for contacts and joints. Worlds whose parts
of a step begin together are solved together.
"""

from dataclasses import replace

import torch
from torch import Tensor

from pinwm_drake.errors import SolverError
from pinwm_drake.physics.cone import ContactProblem
from pinwm_drake.physics.kernels.detect import TOUCHING
from pinwm_drake.physics.kernels.dynamics import IMPACT, POSITION, VELOCITY
from pinwm_drake.physics.kernels.impact import GRAZES, LANDED, MOST_LOOKS, NEAR
from pinwm_drake.physics.kernels.rollout import NOTHING
from pinwm_drake.physics.kernels.stabilise import CONTACT, KAPPA, MOST_PUSHED, ROUNDING, ROUNDS, SLOP
from pinwm_drake.physics.kernels.step import BENT, MOST_IMPACTS, SHORTEST
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.reference_rows import (
    Contacts,
    Features,
    find_contacts,
    select_features,
)
from pinwm_drake.physics.reference_stage import build_stage, move
from pinwm_drake.physics.state import State, Trajectory


def build_problem(
    model: Model, parameters: Parameters, state: State, V_WP: Tensor
) -> tuple[ContactProblem, Contacts, tuple[Tensor, Tensor], Tensor]:
    """Equations of the position stage of a step: problem, contacts, joints (J_e, error_e), free velocity (W, 6 nb)."""
    h = torch.full_like(state.p_WP[:, 0], model.time_step)
    features = select_features(model, parameters, state, V_WP, h)
    stage = build_stage(model, parameters, features, state, V_WP, h, POSITION)
    return stage.problem, stage.contacts, stage.joints, stage.free


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


def _share(a: Tensor, b: Tensor, c: Tensor, at_a: Tensor, at_b: Tensor, at_c: Tensor) -> Tensor:
    """Share of the way from a to b at which to look next for a zero; see `kernels/impact.py`."""
    xi, phi = (a - b) / (c - b), (at_a - at_b) / (at_c - at_b)
    if bool(phi**2 >= xi) or bool((1.0 - phi) ** 2 >= 1.0 - xi):
        return torch.full_like(a, 0.5)
    toward_b = at_a / (at_b - at_a) * at_c / (at_b - at_c)
    share = toward_b + (c - a) / (b - a) * at_a / (at_c - at_a) * at_b / (at_c - at_b)
    return share if bool((share > 0.0) & (share < 1.0)) else torch.full_like(a, 0.5)


def _touch(
    model: Model, parameters: Parameters, features: Features, state: State, V_WP: Tensor, h: Tensor, away: Tensor
) -> tuple[Tensor, bool]:
    """Length (1,) of one world's part until what is away (1, C) touches, s, and whether it touches."""
    nb = model.num_bodies

    def after(length: Tensor) -> tuple[State, Tensor]:
        stage = build_stage(model, parameters, features, state, V_WP, length, POSITION)
        V = stage.solve(away)[:, : 6 * nb].unflatten(1, (nb, 6))
        moved = move(state, V, V_WP, length)
        gap = find_contacts(model, parameters, features, moved).gap
        return moved, torch.where(out, gap, torch.full_like(gap, torch.inf))

    out = away
    while bool(out.any()):
        with torch.no_grad():
            moved, gap = after(h)
            if float(gap.min()) > 0.0:
                break
            at_b = torch.where(out, find_contacts(model, parameters, features, state).gap, gap.abs() + 1.0).min()
            a, at_a, b = h, gap.min(), torch.zeros_like(h)
            share = at_a / (at_a - at_b)
            for _ in range(MOST_LOOKS):
                if abs(float(at_a)) <= LANDED:
                    break
                length = a + share * (b - a)
                moved, gap = after(length)
                landed, c, at_c = gap.min(), a, at_a
                if bool(landed > 0.0) != bool(at_a > 0.0):
                    c, at_c, b, at_b = b, at_b, a, at_a
                a, at_a = length, landed
                share = _share(a, b, c, at_a, at_b, at_c)
            length = a
            hit = int(gap[0].argmin())
            A, B = features.body[0, hit]
            if nb + 1 != B:
                still = replace(moved, V_WB=torch.zeros_like(moved.V_WB))
                near = select_features(model, parameters, still, torch.zeros_like(V_WP), h)
                found = find_contacts(model, parameters, near, still)
                pair = found.valid & (found.body[..., 0] == A) & (found.body[..., 1] == B)
                if not bool((found.gap[pair] < NEAR).any()):
                    out = out & (torch.arange(out.shape[1], device=out.device) != hit)
                    continue
        with torch.enable_grad():
            leaf = length.detach().requires_grad_()
            gap = after(leaf)[1][0, hit]
            (speed,) = torch.autograd.grad(gap, leaf, retain_graph=True)
            # The implicit function theorem: length' = -gap' / (d gap / d length).
            value = after(length.detach())[1][0, hit]
            length = length.detach()
            if abs(float(speed)) > GRAZES:
                length = length - (value - value.detach()) / speed
        return length, True
    return h, False


def _part(
    model: Model, parameters: Parameters, features: Features, state: State, V_WP: Tensor, h: Tensor, may_stop: Tensor
) -> tuple[State, Tensor, Tensor, Tensor]:
    """Take a part of a step, of length h (W,) or less.

    Returns:
        States after it, its lengths, whether it ends in a hit, and whether it bends too much and is to be shorter.
    """
    nb, W = model.num_bodies, state.num_worlds
    stage = build_stage(model, parameters, features, state, V_WP, h, POSITION)
    x = stage.solve()
    apart = (stage.impulse(x) > 0.0) & ~stage.closed & may_stop[:, None]
    away, hits = torch.zeros_like(stage.closed), torch.zeros(W, dtype=torch.bool, device=h.device)
    lengths = list(h.split(1))
    for w in torch.nonzero(apart.any(-1))[:, 0].tolist():
        one = torch.tensor([w], device=h.device)
        away[w] = stage.contacts.valid[w] & ~stage.closed[w]
        theta, start = parameters.worlds(one), state.worlds(one)
        lengths[w], hits[w] = _touch(model, theta, features.of(one), start, V_WP[one], h[one], away[one])
    if bool(apart.any()):
        h = torch.cat(lengths)
        stage = build_stage(model, parameters, features, state, V_WP, h, POSITION)
        x = stage.solve(away)
    u = x[:, : 6 * nb].unflatten(1, (nb, 6))
    impulse = torch.where(away, torch.zeros_like(stage.problem.limit), stage.impulse(x))
    delta = _stabilise(model, stage.contacts, impulse >= stage.problem.limit, stage.joints).unflatten(1, (nb, 6))
    moved = move(state, u, V_WP, h, torch.where(hits[:, None, None], torch.zeros_like(delta), delta))
    gap = find_contacts(model, parameters, features, moved).gap
    takes_part = (impulse > 0.0) | (stage.closed & (gap <= TOUCHING))
    after = build_stage(model, parameters, features, moved, V_WP, h, VELOCITY, takes_part)
    V = after.solve()[:, : 6 * nb].unflatten(1, (nb, 6))
    bends = ((stage.bent > BENT) & (impulse > 0.0)).any(-1)
    return replace(moved, V_WB=V), h, hits, bends


def _impact(model: Model, parameters: Parameters, features: Features, state: State, V_WP: Tensor) -> State:
    """Take an impact of what touches."""
    nb = model.num_bodies
    stage = build_stage(model, parameters, features, state, V_WP, torch.zeros_like(V_WP[:, 0]), IMPACT)
    return replace(state, V_WB=stage.solve()[:, : 6 * nb].unflatten(1, (nb, 6)))


def _chosen(first: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """Return rows of a where `first` (W,), else of b."""
    return torch.where(first.reshape(-1, *[1] * (a.ndim - 1)), a, b)


def step_reference(model: Model, parameters: Parameters, state: State, V_WP: Tensor) -> State:
    """Discrete update by one step of all worlds; see `Stepper.step`. What would be deep is not stepped in halves."""
    W, device = state.num_worlds, state.p_WP.device
    done: dict[int, State] = {}
    going = torch.arange(W, device=device)
    left = length = torch.full_like(state.p_WP[:, 0], model.time_step)
    impacts = torch.zeros(W, dtype=torch.long, device=device)
    after_impact = torch.zeros(W, dtype=torch.bool, device=device)
    while len(going):
        theta, push = parameters.worlds(going), V_WP[going]
        features = select_features(model, theta, state, push, torch.minimum(length, left))
        may_stop = impacts < MOST_IMPACTS
        start = build_stage(model, theta, features, state, push, torch.minimum(length, left), POSITION)
        strikes = start.strikes.any(-1) & may_stop & ~after_impact
        states, next_left, hit, again = [], left, torch.zeros_like(strikes), torch.zeros_like(strikes)
        moving = torch.nonzero(~strikes)[:, 0]
        groups = [torch.nonzero(strikes)[:, 0]]
        if len(groups[0]):
            at = groups[0]
            states.append(_impact(model, theta.worlds(at), features.of(at), state.worlds(at), push[at]))
        if len(moving):
            at = moving
            before, wanted = state.worlds(at), torch.minimum(length, left)[at]
            part, h, hits, bends = _part(
                model, theta.worlds(at), features.of(at), before, push[at], wanted, may_stop[at]
            )
            bends = bends & (wanted > SHORTEST * model.time_step)
            part = State(*(_chosen(bends, a, b) for a, b in zip(before.tensors(), part.tensors(), strict=True)))
            again = again.index_copy(0, at, bends)
            h, hits = torch.where(bends, torch.zeros_like(h), h), hits & ~bends
            length = length.index_copy(0, at, torch.where(bends, 0.5 * wanted, length[at]))
            next_left = left.index_add(0, moving, -h)
            hit = hit.index_copy(0, moving, hits)
            struck = torch.nonzero(hits)[:, 0]
            if len(struck):
                at = moving[struck]
                after = _impact(model, theta.worlds(at), features.of(at), part.worlds(struck), push[at])
                part = State(
                    *(a.index_copy(0, struck, b) for a, b in zip(part.tensors(), after.tensors(), strict=True))
                )
            states.append(part)
            groups.append(moving)
        order = torch.argsort(torch.cat([g for g in groups if len(g)]))
        state = State(*(torch.cat(list(t))[order] for t in zip(*(one.tensors() for one in states), strict=True)))
        length = torch.where(hit, next_left, length)
        impacts, after_impact = impacts + (hit | strikes), hit | strikes | (again & after_impact)
        ends = next_left.detach() <= NOTHING * model.time_step
        for k in torch.nonzero(ends)[:, 0].tolist():
            done[int(going[k])] = state.worlds(torch.tensor([k], device=device))
        keep = torch.nonzero(~ends)[:, 0]
        state, left, impacts, length = state.worlds(keep), next_left[keep], impacts[keep], length[keep]
        after_impact, going = after_impact[keep], going[keep]
    return State(*(torch.cat(list(tensors)) for tensors in zip(*(done[w].tensors() for w in range(W)), strict=True)))


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
