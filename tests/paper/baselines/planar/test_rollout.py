# SPDX-License-Identifier: MIT
"""Rollouts in the plane."""

import math

import numpy as np
import pytest
import torch

from pinwm_drake.errors import ParameterError, PinwmError, StateError
from pinwm_drake.paper.baselines.planar.kernel import slide
from pinwm_drake.paper.baselines.planar.rollout import (
    Feature,
    PlanarParameters,
    PlanarPush,
    rollout,
    step_residual,
    touch,
)
from tests.paper.baselines.planar.shapes import disc_body, even, square_body, t_body, uneven

H = 1.0 / 240.0
G = 9.81


def still(steps: int, at: tuple[float, float] = (9.0, 9.0)) -> PlanarPush:
    """A pusher that stands, far away where no place is given."""
    return PlanarPush(torch.tensor([at], dtype=torch.float64).expand(steps + 1, 2).contiguous(), 0.01, H)


def straight(begin: tuple[float, float], velocity: tuple[float, float], steps: int) -> PlanarPush:
    """A pusher that moves evenly."""
    times = H * torch.arange(steps + 1, dtype=torch.float64)[:, None]
    return PlanarPush(
        torch.tensor(begin, dtype=torch.float64) + times * torch.tensor(velocity, dtype=torch.float64), 0.01, H
    )


def zeros(worlds: int = 1) -> torch.Tensor:
    return torch.zeros(worlds, 3, dtype=torch.float64)


def energies(body, parameters: PlanarParameters, poses: torch.Tensor) -> np.ndarray:
    """Kinetic energies (T,) of one world, J."""
    sliding = parameters.sliding(body, G)
    c, s = poses[:, 0, 2].cos(), poses[:, 0, 2].sin()
    px, py = sliding.center[0]
    middle = poses[:, 0, :2] + torch.stack([c * px - s * py, s * px + c * py], -1)
    v, rate = middle.diff(dim=0) / H, poses[:, 0, 2].diff() / H
    return (0.5 * (sliding.mass * v.square().sum(-1) + sliding.inertia * rate.square())).numpy()


def test_slides_to_rest_after_its_way(tmp_path):
    body, mu, v = square_body(tmp_path), 0.2, 0.5
    velocity = torch.tensor([[v, 0.0, 0.0]], dtype=torch.float64)
    poses = rollout(body, even(body, friction=mu), zeros(), still(120), velocity=velocity)
    # v^2 / (2 mu g), less half of the first step's way, as velocities count at the steps' ends.
    assert float(poses[-1, 0, 0]) == pytest.approx(v**2 / (2 * mu * G) - 0.5 * v * H, abs=1e-5)
    assert float((poses[-1] - poses[-20]).abs().max()) < 1e-12
    assert float(poses[:, 0, 1:].abs().max()) < 1e-12


def test_a_spinning_disc_stops_in_time(tmp_path):
    radius, mu, rate = 0.05, 0.2, 20.0
    body = disc_body(tmp_path, radius=radius)
    velocity = torch.tensor([[0.0, 0.0, rate]], dtype=torch.float64)
    poses = rollout(body, even(body, friction=mu), zeros(), still(150), velocity=velocity)
    # Torque 2/3 mu m g R against inertia m R^2 / 2; to within how squares make a disc.
    slowing = 4.0 * mu * G / (3.0 * radius)
    assert float(poses[-1, 0, 2]) == pytest.approx(rate**2 / (2 * slowing) - 0.5 * rate * H, rel=0.03)
    rates = (poses[:, 0, 2].diff() / H).numpy()
    assert H * np.argmax(rates < 1e-2 * rate) == pytest.approx(rate / slowing, rel=0.03)
    assert float(poses[:, 0, :2].abs().max()) < 1e-9


def test_moves_on_for_ever_without_friction(tmp_path):
    body = t_body(tmp_path)
    parameters = PlanarParameters(uneven(body).mass, 0.0 * even(body).friction, even(body).friction_pusher)
    velocity = torch.tensor([[0.1, -0.2, 3.0]], dtype=torch.float64)
    poses = rollout(body, parameters, zeros(), still(100), velocity=velocity)
    found = energies(body, parameters, poses)
    np.testing.assert_allclose(found, found[0], rtol=1e-10)
    np.testing.assert_allclose(poses[:, 0, 2], 3.0 * H * np.arange(101), atol=1e-10)


@pytest.mark.parametrize("velocity", [(0.3, 0.1, 5.0), (0.02, -0.4, -1.0), (0.0, 0.0, 9.0)])
def test_friction_makes_no_energy(tmp_path, velocity):
    body = t_body(tmp_path)
    parameters = uneven(body)
    poses = rollout(body, parameters, zeros(), still(100), velocity=torch.tensor([velocity], dtype=torch.float64))
    found = energies(body, parameters, poses)
    assert (np.diff(found) <= 1e-12 * found[0]).all()
    assert found[-1] < 1e-3 * found[0]


def test_a_pusher_in_the_way_makes_no_energy(tmp_path):
    body = t_body(tmp_path)
    parameters = PlanarParameters(uneven(body).mass, 0.01 * uneven(body).friction, even(body).friction_pusher)
    velocity = torch.tensor([[0.4, 0.0, -2.0]], dtype=torch.float64)
    poses = rollout(body, parameters, zeros(), still(100, (0.09, 0.02)), velocity=velocity)
    found = energies(body, parameters, poses)
    assert found[-1] < 0.9 * found[0]  # it was hit
    # What overlaps after a step, by the turning in it (0.4 m/s times 2/s times H^2), is let go at 0.02 m/s at the most.
    assert (np.diff(found) <= 0.5 * 0.7 * 0.02**2).all()


def test_a_push_through_the_centre_of_friction_does_not_turn(tmp_path):
    body = square_body(tmp_path)
    for y, turns in ((0.0, False), (0.01, True)):
        poses = rollout(body, even(body), zeros(), straight((-0.06, y), (0.1, 0.0), 120))
        assert (abs(float(poses[-1, 0, 2])) > 0.01) == turns
        if not turns:
            assert float(poses[:, 0, 1:].abs().max()) < 1e-9
            # Without a bounce it goes with the pusher, which its side follows: 0.06 - 0.01 - 0.04 m were between them.
            assert float(poses[-1, 0, 0]) == pytest.approx(0.1 * 120 * H - 0.01, abs=1e-5)


def test_a_pusher_in_a_concave_corner_touches_both_sides(tmp_path):
    body = t_body(tmp_path)
    # Corner between bar and stem at (0.02, -0.015): pushed along the diagonal, both sides stay 0.01 m away.
    push = straight((0.045, 0.01), (-0.05, -0.05), 100)
    poses = rollout(body, even(body, pusher=0.0), zeros(), push)
    x, y, yaw = (float(value) for value in poses[-1, 0])
    px, py = (float(value) for value in push.path[-1])
    at = (
        math.cos(yaw) * (px - x) + math.sin(yaw) * (py - y),
        math.cos(yaw) * (py - y) - math.sin(yaw) * (px - x),
    )
    assert at[0] == pytest.approx(0.03, abs=3e-4)
    assert at[1] == pytest.approx(-0.005, abs=3e-4)


def test_friction_at_the_pusher_drags_the_object_along(tmp_path):
    body = square_body(tmp_path)
    ways = []
    for friction in (0.0, 0.5):
        # The pusher moves on to the side and along it.
        poses = rollout(body, even(body, pusher=friction), zeros(), straight((-0.055, -0.01), (0.05, 0.03), 60))
        ways.append(float(poses[-1, 0, 1]))
    assert ways[1] > ways[0] + 2e-3


def test_the_scale_of_the_mass_has_no_effect(tmp_path):
    body = t_body(tmp_path)
    one = uneven(body)
    push = straight((0.01, -0.07), (0.0, 0.15), 120)
    heavy = PlanarParameters(3.0 * one.mass, one.friction, one.friction_pusher)
    poses = [rollout(body, parameters, zeros(), push) for parameters in (one, heavy)]
    assert float((poses[0] - poses[1]).abs().max()) < 1e-8
    assert float(poses[0][-1].abs().max()) > 0.01


def test_worlds_do_not_mix(tmp_path):
    body = t_body(tmp_path)
    parameters = uneven(body, 3)
    push = straight((0.01, -0.07), (0.0, 0.15), 60)
    together = rollout(body, parameters, zeros(3), push)
    for w in range(3):
        alone = PlanarParameters(
            parameters.mass[w : w + 1], parameters.friction[w : w + 1], parameters.friction_pusher[w : w + 1]
        )
        assert torch.equal(rollout(body, alone, zeros(), push)[:, 0], together[:, w])


# Pushed at a side, with the pusher sliding; at a corner; and thrown, without a pusher.
@pytest.mark.parametrize(
    ("begin", "pushed", "velocity"),
    [
        ((0.013, -0.07), (0.05, 0.15), (0.0, 0.0, 0.0)),
        ((0.055, -0.068), (-0.05, 0.12), (0.0, 0.0, 0.0)),
        ((0.3, 0.3), (0.0, 0.0), (0.3, 0.1, 4.0)),
    ],
)
def test_gradients_are_those_of_finite_differences(tmp_path, begin, pushed, velocity):
    body = t_body(tmp_path)
    one = uneven(body, 2)
    push = straight(begin, pushed, 60)
    generator = torch.Generator().manual_seed(1)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    cotangent = draw(61, 2, 3)
    first = torch.tensor([velocity], dtype=torch.float64).expand(2, 3)
    inputs = [one.mass, one.friction, one.friction_pusher, zeros(2), first.clone()]
    assert float((rollout(body, one, zeros(2), push, velocity=first)[-1]).abs().max()) > 0.005

    def value(mass, friction, pusher, start, rate) -> torch.Tensor:
        found = rollout(body, PlanarParameters(mass, friction, pusher), start, push, velocity=rate)
        return (found * cotangent).sum()

    leaves = [tensor.clone().requires_grad_() for tensor in inputs]
    gradients = torch.autograd.grad(value(*leaves), leaves)
    for number, (tensor, gradient) in enumerate(zip(inputs, gradients, strict=True)):
        way = draw(*tensor.shape) * tensor.abs().max().clamp_min(0.1)
        ends = []
        for sign in (1.0, -1.0):
            moved = list(inputs)
            moved[number] = tensor + sign * 1e-6 * way
            ends.append(float(value(*moved)))
        # Differences of 1e-6: rounding of 1e-12 over 2e-6, and curvature.
        slope = (ends[0] - ends[1]) / 2e-6
        assert float((gradient * way).sum()) == pytest.approx(slope, rel=2e-4, abs=2e-6)


@pytest.mark.parametrize(
    ("path", "radius", "time_step", "error"),
    [
        (torch.zeros(3, 3), 0.01, H, StateError),
        (torch.zeros(1, 2), 0.01, H, StateError),
        (torch.full((3, 2), math.nan), 0.01, H, StateError),
        (torch.zeros(3, 2), 0.0, H, ParameterError),
        (torch.zeros(3, 2), 0.01, 0.1, ParameterError),
    ],
)
def test_a_bad_push_is_refused(path, radius, time_step, error):
    with pytest.raises(error, match="allowed"):
        PlanarPush(path.double(), radius, time_step)


def test_an_object_without_mass_does_not_converge(tmp_path):
    body = square_body(tmp_path)
    parameters = even(body)
    broken = PlanarParameters(parameters.mass * math.nan, parameters.friction, parameters.friction_pusher)
    with pytest.raises(PinwmError, match="did not converge"):
        rollout(body, broken, zeros(), still(2))


H, RADIUS = 1.0 / 240.0, 0.01


def solve(body, sliding, path: torch.Tensor, start: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Poses, velocities, Hessians and features of the kernel's steps."""
    T, W = len(path) - 1, len(start)
    poses, velocities = torch.zeros(T + 1, W, 3).double(), torch.zeros(T + 1, W, 3).double()
    poses[0] = start
    found = [poses, velocities, torch.zeros(T, W, 3, 3).double()]
    found += [
        torch.zeros(T, W, 2, 2).double(),
        torch.zeros(T, W, 2, 2).double(),
        torch.zeros(T, W, 2, dtype=torch.bool),
    ]
    given = [part.contiguous().numpy() for part in sliding]
    failed = slide(body.outlines.numpy(), path.numpy(), RADIUS, H, *given, *(part.numpy() for part in found))
    assert failed == -1
    return tuple(found)


def test_the_kernel_solves_the_equation_and_knows_its_derivative(tmp_path):
    body = t_body(tmp_path)
    sliding = uneven(body, 4).sliding(body, 9.81)
    times = H * torch.arange(81, dtype=torch.float64)[:, None]
    path = torch.tensor([[0.045, 0.01]]).double() + times * torch.tensor([[-0.11, -0.06]]).double()
    start = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.01, 0.0, -0.3], [0.0, -0.004, 0.1]]).double()
    poses, velocities, hessians, *features = solve(body, sliding, path, start)
    kinds = set()
    for k in range(80):
        yaw = poses[k, :, 2]
        c, s = yaw.cos(), yaw.sin()

        def own(v: torch.Tensor, c=c, s=s) -> torch.Tensor:
            return torch.stack([c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0]], -1)

        middle = own(path[k] - poses[k, :, :2]) + sliding.center
        contact = touch(Feature(*(part[k] for part in features)), middle, RADIUS)
        v = own(((path[k + 1] - path[k]) / H).expand(4, 2))
        before, after = (torch.cat([own(velocities[j, :, :2]), velocities[j, :, 2:]], -1) for j in (k, k + 1))

        def equation(V: torch.Tensor, before=before, contact=contact, v=v) -> torch.Tensor:
            return step_residual(V, before, sliding, contact, v, H)

        # 1e-11 m/s of a Newton step, times the stiffness of a contact, 100 times the mass.
        assert float(equation(after).abs().max()) < 1e-9
        derivative = torch.autograd.functional.jacobian(lambda V: equation(V).sum(0), after).swapaxes(0, 1)
        np.testing.assert_allclose(hessians[k], derivative, atol=1e-6 * float(derivative.abs().max()))
        kinds |= {
            (bool(flat), bool(gap < 1e-4)) for flat, gap in zip(features[2][k, :, 0], contact.gap[:, 0], strict=True)
        }
    assert (True, True) in kinds  # an edge was touched
    assert float((poses[-1] - poses[0]).abs().amax(-1).min()) > 1e-3  # all of them moved


def test_distances_are_those_of_many_points_of_the_outlines(tmp_path):
    body = t_body(tmp_path)
    generator = torch.Generator().manual_seed(0)
    middles = (torch.rand(200, 2, generator=generator).double() - 0.5) * 0.3
    sliding = uneven(body, 200).sliding(body, 9.81)
    # One step without motion: the features are those of the start.
    start = torch.cat([sliding.center - middles, torch.zeros(200, 1).double()], -1)
    *_, first, normal, flat = solve(body, sliding, torch.zeros(2, 2).double(), start)
    contact = touch(Feature(first[0], normal[0], flat[0]), middles, 0.0)
    share = torch.linspace(0.0, 1.0, 2001).double()[:, None, None, None]
    points = body.outlines + share * (body.outlines.roll(-1, 1) - body.outlines)
    nearest = torch.stack([(points - middle).norm(dim=-1).amin((0, 2)) for middle in middles])  # (200, P)
    outside = (contact.gap > 0.0).all(-1)
    assert 100 < int(outside.sum()) < 200
    order = nearest.sort(-1).values
    np.testing.assert_allclose(contact.gap[outside], order[outside], atol=1e-4)
    np.testing.assert_allclose(contact.normal.norm(dim=-1), 1.0, rtol=1e-12)
    # Inside of an outline the distance is that of its border, and negative.
    inside = nearest * torch.where(_within(body.outlines, middles), -1.0, 1.0)
    np.testing.assert_allclose(contact.gap[~outside], inside[~outside].sort(-1).values, atol=1e-4)


def _within(outlines: torch.Tensor, middles: torch.Tensor) -> torch.Tensor:
    """Flags (n, P) of middles (n, 2) that are to the left of all edges of outlines (P, E, 2)."""
    span, away = outlines.roll(-1, 1) - outlines, middles[:, None, None] - outlines
    return (span[..., 0] * away[..., 1] - span[..., 1] * away[..., 0] >= 0.0).all(-1)
