# SPDX-License-Identifier: MIT
"""Rollout of a sliding object along a pusher's motion; differentiable by the implicit function of each step."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.errors import SolverError, StateError, require
from pinwm_drake.paper.baselines.planar.body import PlanarBody
from pinwm_drake.paper.baselines.planar.kernel import COMPLIANCE, CONTACTS, CREEP, PARTING, slide


class Sliding(NamedTuple):
    """Properties of W objects that their steps depend on.

    Attributes:
        mass: (W,), kg.
        inertia: (W,), about the centre of mass, kg m^2.
        arm: (W, C, 2), cells from the centre of mass, m, frame Q.
        load: (W, C), friction at full slip, N.
        center: (W, 2), centre of mass, m, frame Q.
        friction_pusher: (W,), Coulomb coefficient of object and pusher.
    """

    mass: Tensor
    inertia: Tensor
    arm: Tensor
    load: Tensor
    center: Tensor
    friction_pusher: Tensor


class Feature(NamedTuple):
    """Edges and corners of outlines that are nearest to a pusher.

    Attributes:
        first: (..., K, 2), corner, or first corner of the edge, m, frame Q.
        normal: (..., K, 2), outward unit normal of the edge.
        flat: (..., K) bool, true for an edge.
    """

    first: Tensor
    normal: Tensor
    flat: Tensor


class Contact(NamedTuple):
    """Contacts of a pusher; on the object's side they act at points of the outlines, which move with it.

    Attributes:
        gap: (..., K), m, distance from outline to pusher.
        normal: (..., K, 2), outward unit normals, frame Q.
        point: (..., K, 2), m, frame Q.
    """

    gap: Tensor
    normal: Tensor
    point: Tensor


def touch(feature: Feature, middle: Tensor, radius: float) -> Contact:
    """Contacts of a pusher with features; differentiable in its place.

    Args:
        feature: The features.
        middle: (..., 2), the pusher's middle, m, frame Q.
        radius: Radius of the pusher, m.
    """
    off = middle[..., None, :] - feature.first
    square = torch.where(feature.flat, torch.ones_like(off[..., 0]), off.square().sum(-1))
    distance = torch.where(feature.flat, (off * feature.normal).sum(-1), square.sqrt())
    normal = torch.where(feature.flat[..., None], feature.normal, off / square.sqrt()[..., None])
    return Contact(distance - radius, normal, middle[..., None, :] - distance[..., None] * normal)


def step_residual(V: Tensor, before: Tensor, body: Sliding, contact: Contact, v: Tensor, time_step: float) -> Tensor:
    """Momentum that a step leaves unexplained; zero at the velocity at the step's end.

    Args:
        V: (..., W, 3), velocity of the centre of mass [m/s] and rate of yaw [rad/s] at the step's end, axes of Q.
        before: (..., W, 3), velocity at the step's beginning, axes of Q.
        body: Properties of the W objects.
        contact: (..., W, K), contacts with the pusher at the step's beginning.
        v: (..., W, 2), the pusher's velocity, m/s, axes of Q.
        time_step: s.

    Returns:
        (..., W, 3), N s and N m s.
    """
    M = torch.stack([body.mass, body.mass, body.inertia], -1)
    x, y = body.arm.unbind(-1)
    u, w = V[..., 0, None] - V[..., 2, None] * y, V[..., 1, None] + V[..., 2, None] * x
    k = time_step * body.load / (u * u + w * w + CREEP * CREEP).sqrt()
    friction = torch.stack([(k * u).sum(-1), (k * w).sum(-1), (k * (x * w - y * u)).sum(-1)], -1)
    return M * (V - before) + friction + _push(V, contact, body, v, time_step)


def _push(V: Tensor, contact: Contact, body: Sliding, v: Tensor, time_step: float) -> Tensor:
    """Impulses (..., W, 3) of the object on the pusher: a projection onto the friction cone; as for `step_residual`.

    Sliding along a pusher, the object keeps off by friction times the way of a step, which is negligible.
    """
    n = contact.normal
    axes = torch.stack([n, torch.stack([-n[..., 1], n[..., 0]], -1)], -2)
    arm = contact.point - body.center[:, None]
    J = torch.cat([axes, (arm[..., None, 0] * axes[..., 1] - arm[..., None, 1] * axes[..., 0])[..., None]], -1)
    relative = (axes * v[..., None, None, :]).sum(-1) - (J * V[..., None, None, :]).sum(-1)
    R, mu = (COMPLIANCE / body.mass)[:, None], body.friction_pusher[:, None]
    y_n = (-(contact.gap / time_step).clamp_min(-PARTING) - relative[..., 0]) / R
    y_t = -relative[..., 1] / R
    zero, size = torch.zeros_like(y_n), y_t.abs()
    apart, stick = y_n <= -mu * size, size <= mu * y_n
    e = torch.where(apart, zero, torch.where(stick, y_n, (y_n + mu * size) / (1.0 + mu * mu)))
    f = torch.where(apart, zero, torch.where(stick, y_t, mu * y_t.sign() * e))
    return (J * torch.stack([e, f], -1)[..., None]).sum((-3, -2))


@dataclass(frozen=True, eq=False)
class PlanarParameters:
    """Unknown properties of W objects of one shape, cell by cell.

    Attributes:
        mass: (W, C), masses of the cells, kg.
        friction: (W, C), Coulomb coefficients of the cells on the floor.
        friction_pusher: (W,), Coulomb coefficient of object and pusher.
    """

    mass: Tensor
    friction: Tensor
    friction_pusher: Tensor

    def sliding(self, body: PlanarBody, gravity: float) -> Sliding:
        """Properties of the moving objects; a cell is a square of even density, and carries its own weight."""
        mass = self.mass.sum(-1)
        center = (self.mass[..., None] * body.cells).sum(-2) / mass[:, None]
        arm = body.cells - center[:, None]
        own = body.size**2 / 6.0
        inertia = (self.mass * (arm.square().sum(-1) + own)).sum(-1)
        return Sliding(mass, inertia, arm, gravity * self.friction * self.mass, center, self.friction_pusher)


@dataclass(frozen=True, eq=False)
class PlanarPush:
    """Motion of a round pusher in time steps.

    Attributes:
        path: (T + 1, 2), middles, m, world.
        radius: m.
        time_step: s.
    """

    path: Tensor
    radius: float
    time_step: float

    def __post_init__(self) -> None:
        if self.path.ndim != 2 or self.path.shape[1] != 2 or len(self.path) < 2 or not self.path.isfinite().all():
            raise StateError(f"path has shape {tuple(self.path.shape)}; allowed: (T + 1, 2), finite, with T 1 or more")
        require("radius", self.radius, 0.0 < self.radius < math.inf, "more than 0 m")
        require("time_step", self.time_step, 0.0 < self.time_step <= 0.02, "more than 0, up to 0.02 s")


def rollout(
    body: PlanarBody,
    parameters: PlanarParameters,
    start: Tensor,
    push: PlanarPush,
    *,
    gravity: float = 9.81,
    velocity: Tensor | None = None,
) -> Tensor:
    """Poses of W objects while a pusher moves; differentiable in the parameters, the start and its velocity.

    Args:
        body: Shape of the objects.
        parameters: Properties of the objects.
        start: (W, 3), pose of Q: x, y [m], yaw [rad].
        push: The pusher's motion.
        gravity: m/s^2.
        velocity: (W, 3), velocity of the centre of mass [m/s] and rate of yaw [rad/s] at first, world; None for rest.

    Returns:
        (T + 1, W, 3), poses of Q at the steps' ends, the start first.

    Raises:
        SolverError: A step did not converge.
    """
    sliding = parameters.sliding(body, gravity)
    place = start[..., :2] + turned(start[..., 2], sliding.center)
    velocity = torch.zeros_like(start) if velocity is None else velocity
    at = torch.cat([place, start[..., 2:]], -1)
    poses = _Rollout.apply(body.outlines, push, at, velocity, *sliding)  # type: ignore[no-untyped-call]
    return torch.cat([poses[..., :2] - turned(poses[..., 2], sliding.center), poses[..., 2:]], -1)


def turned(yaw: Tensor, vector: Tensor) -> Tensor:
    """Vectors (..., 2), turned by angles (...) [rad]."""
    c, s = yaw.cos(), yaw.sin()
    x, y = vector[..., 0], vector[..., 1]
    return torch.stack([c * x - s * y, s * x + c * y], -1)


def _own_axes(yaw: Tensor, V: Tensor) -> Tensor:
    """Velocities (..., 3) of the world, in the axes of objects with these angles (...)."""
    return torch.cat([turned(-yaw, V[..., :2]), V[..., 2:]], -1)


def _turning(V: Tensor) -> Tensor:
    """Return the derivative (..., 3) of velocities V (..., 3) in an object's axes by its angle, as these axes turn."""
    return torch.stack([V[..., 1], -V[..., 0], torch.zeros_like(V[..., 0])], -1)


class _Rollout(torch.autograd.Function):
    """Steps one after the other; backward, their equations all at once, and the adjoint from the last to the first.

    Poses are those of the centre of mass.
    """

    @staticmethod
    def forward(
        ctx: Any, outlines: Tensor, push: PlanarPush, start: Tensor, velocity: Tensor, *sliding: Tensor
    ) -> Tensor:
        steps, (worlds, K) = len(push.path) - 1, (len(start), min(CONTACTS, len(outlines)))
        poses, velocities = (torch.cat([first[None], first.new_empty(steps, worlds, 3)]) for first in (start, velocity))
        hessians, corners = start.new_empty(steps, worlds, 3, 3), start.new_empty(steps, worlds, K, 2)
        feature = Feature(corners, torch.empty_like(corners), torch.empty(steps, worlds, K, dtype=torch.bool))
        given, found = (outlines, push.path), (poses, velocities, hessians, *feature)
        failed = slide(
            *(tensor.contiguous().numpy() for tensor in given),
            push.radius,
            push.time_step,
            *(tensor.contiguous().numpy() for tensor in sliding),
            *(tensor.numpy() for tensor in found),
        )
        if failed >= 0:
            raise SolverError("a step of the planar simulator did not converge", worlds=(failed,))
        ctx.push = push
        ctx.save_for_backward(poses, velocities, hessians, *feature, *sliding)
        return poses

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        (bar,), push = grads, ctx.push
        h, moves = push.time_step, push.path.diff(dim=0) / push.time_step
        poses, velocities, hessians, corners, normals, flat, *sliding = ctx.saved_tensors
        yaw = poses[:-1, :, 2]
        V, before = _own_axes(yaw, velocities[1:]), _own_axes(yaw, velocities[:-1])
        with torch.enable_grad():
            inputs = [tensor.detach().requires_grad_() for tensor in sliding]
            body = Sliding(*inputs)
            q = poses[:-1].detach().requires_grad_()
            middle = turned(-q[..., 2], push.path[:-1, None] - q[..., :2]) + body.center
            own = turned(-q[..., 2], moves[:, None].expand_as(q[..., :2]))
            contact = touch(Feature(corners, normals, flat), middle, push.radius)
            residual = step_residual(V, before, body, contact, own, h)
            # Each step and world depends on its own pose only: by way of the contact, and of the axes below.
            rows = [torch.autograd.grad(residual[..., axis].sum(), q, retain_graph=True)[0] for axis in range(3)]
        M = torch.stack([body.mass, body.mass, body.inertia], -1).detach()
        by_pose = torch.stack(rows, -2)
        by_pose[..., 2] += (hessians @ _turning(V)[..., None])[..., 0] - M * _turning(before)
        arrays = (bar, yaw, torch.linalg.inv(hessians), by_pose, M)
        q_bar, V_bar, lambdas = _adjoint(h, *(tensor.numpy() for tensor in arrays))
        found = torch.autograd.grad(residual, inputs, -torch.from_numpy(lambdas), allow_unused=True)
        return None, None, torch.from_numpy(q_bar), torch.from_numpy(V_bar), *found


def _adjoint(
    h: float, bar: np.ndarray, yaw: np.ndarray, inverse: np.ndarray, by_pose: np.ndarray, M: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Adjoint of the steps r(V', q, V) = 0, q' = q + h V' with V, V' in the world and r in the axes of the object.

    Returns:
        Gradients (W, 3) by the first pose and velocity, and (T, W, 3), what the gradient by r is, times -1.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    q_bar, V_bar = bar[-1].copy(), np.zeros_like(bar[-1])
    lambdas = np.empty_like(bar[1:])
    for k in range(len(yaw) - 1, -1, -1):
        a = V_bar + h * q_bar
        own = np.stack([c[k] * a[:, 0] + s[k] * a[:, 1], c[k] * a[:, 1] - s[k] * a[:, 0], a[:, 2]], -1)
        lam = (inverse[k] @ own[..., None])[..., 0]
        lambdas[k] = lam
        q_bar = q_bar + bar[k] - (lam[:, None] @ by_pose[k])[:, 0]
        y = M * lam
        V_bar = np.stack([c[k] * y[:, 0] - s[k] * y[:, 1], s[k] * y[:, 0] + c[k] * y[:, 1], y[:, 2]], -1)
    return q_bar, V_bar, lambdas
