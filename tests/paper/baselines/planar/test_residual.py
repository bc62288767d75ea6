import numpy as np
import torch

from pinwm_drake.paper.baselines.planar.kernel import slide
from pinwm_drake.paper.baselines.planar.residual import Feature, step_residual, touch
from tests.paper.baselines.planar.shapes import t_body, uneven

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
