"""Equation of a step of sliding objects in torch, by which rollouts are differentiated; see `kernel`."""

from typing import NamedTuple

import torch
from torch import Tensor

from pinwm_drake.paper.baselines.planar.kernel import COMPLIANCE, CREEP, PARTING


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
