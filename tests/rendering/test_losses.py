# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch

from pinwm_drake.errors import RenderingError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.losses import (
    SsimTarget,
    distortion_loss,
    normal_consistency,
    photometric,
    ssim,
    window,
)
from pinwm_drake.rendering.render import Rendering, render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose


def images(height=23, width=31, seed=0):
    generator = torch.Generator().manual_seed(seed)
    a = torch.rand(height, width, 3, generator=generator)
    return a, (a + 0.2 * torch.randn(height, width, 3, generator=generator)).clamp(0.0, 1.0)


def ssim_reference(a, b):
    """Wang et al. (2004), eq. 13, by torch's convolutions, in the type of a."""
    weights = torch.from_numpy(window()).to(a)
    kernel = torch.outer(weights, weights).expand(3, 1, 11, 11)

    def blur(x):
        return torch.nn.functional.conv2d(x.permute(2, 0, 1)[None], kernel, padding=5, groups=3)[0]

    ma, mb = blur(a), blur(b)
    va, vb, cov = blur(a * a) - ma**2, blur(b * b) - mb**2, blur(a * b) - ma * mb
    c1, c2 = 0.01**2, 0.03**2
    return ((2 * ma * mb + c1) * (2 * cov + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))).mean()


@pytest.mark.parametrize("size", [(23, 31), (40, 12), (5, 7), (1, 1)])
def test_ssim_equals_its_reference_forward_and_backward(size):
    a, b = images(*size)
    a32 = a.clone().requires_grad_()
    a64 = a.double().requires_grad_()
    value = ssim(a32, b)
    reference = ssim_reference(a64, b.double())
    (3.0 * value).backward()
    (3.0 * reference).backward()
    # float32 sums of 121 products: some 1e-6; variances lose digits by cancellation, but c2 bounds that.
    assert value.item() == pytest.approx(reference.item(), abs=1e-5)
    scale = a64.grad.abs().max().item()
    assert torch.allclose(a32.grad.double(), a64.grad, atol=1e-4 * scale, rtol=0.0)


def test_ssim_of_equal_images_is_1_and_of_opposite_ones_negative():
    a, _ = images()
    assert ssim(a, a).item() == pytest.approx(1.0, abs=1e-6)
    assert ssim(a, 1.0 - a).item() < 0.0


def test_the_window_is_a_gaussian_of_sum_1():
    weights = window()
    assert weights.sum() == pytest.approx(1.0, abs=1e-6)
    assert weights[5] / weights[8] == pytest.approx(np.exp(0.5 * (3 / 1.5) ** 2), rel=1e-5)


def test_photometric_mixes_its_parts():
    a, b = images()
    l1, l2, s = (a - b).abs().mean(), (a - b).square().mean(), ssim(a, b)
    assert photometric(a, b, dssim=0.0) == pytest.approx(l1.item())
    assert photometric(a, b, kind="l2", dssim=0.0) == pytest.approx(l2.item())
    assert photometric(a, b, dssim=0.3).item() == pytest.approx((0.7 * l1 + 0.3 * (1 - s) / 2).item(), rel=1e-5)
    assert photometric(a, SsimTarget(b), dssim=1.0).item() == pytest.approx(((1 - s) / 2).item(), rel=1e-5)


def test_photometric_differentiates():
    a, b = images(9, 8)
    x = a.clone().requires_grad_()
    photometric(x, b, kind="l2", dssim=0.4).backward()
    direction = torch.randn(a.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    y = a.double().requires_grad_()
    (0.6 * (y - b).square().mean() + 0.4 * 0.5 * (1 - ssim_reference(y, b.double()))).backward()
    assert (x.grad * direction).sum().item() == pytest.approx((y.grad * direction).sum().item(), rel=1e-3)


def square_at(X_CO, degrees=0.0, number=40):
    """A wall of surfels in the plane z = 0 of O, turned about its x axis, seen by a camera 0.5 m away."""
    u = torch.linspace(-0.2, 0.2, number)
    x, y = torch.meshgrid(u, u, indexing="xy")
    angle = torch.tensor(np.deg2rad(degrees), dtype=torch.float32)
    p = torch.stack([x, y * angle.cos(), y * angle.sin()], -1).reshape(-1, 3)
    N = len(p)
    q = torch.stack([(angle / 2).cos(), (angle / 2).sin(), angle * 0, angle * 0]).expand(N, 4).contiguous()
    surfels = Surfels(p, q, torch.full((N, 2), np.log(0.008)), torch.full((N,), 4.0), torch.zeros(N, 1, 3))
    camera = Camera(24, 20, torch.tensor([60.0, 60.0, 12.0, 10.0]))
    return surfels, camera, render(surfels, camera, X_CO, backend="torch")


FACING = Pose(torch.tensor([1.0, 0.0, 0.0, 0.0]).double(), torch.tensor([0.0, 0.0, 0.5]).double())


@pytest.mark.parametrize("degrees", [0.0, 30.0, -50.0])
def test_a_plane_has_consistent_normals(degrees):
    _, camera, rendering = square_at(FACING, degrees)
    assert rendering.alpha.min() > 0.9
    # The depth of a plane is that of its points, but where the low-pass disc wins, which takes the surfel's centre:
    # 1.4e-3 was measured at 50 degrees, against 0.36 of normals that are 50 degrees off.
    assert normal_consistency(rendering, camera).item() < 3e-3


def test_normals_that_disagree_cost():
    surfels, camera, _ = square_at(FACING, 0.0)
    turned = torch.tensor(np.deg2rad(40.0))
    q = torch.stack([(turned / 2).cos(), (turned / 2).sin(), turned * 0, turned * 0]).float()
    tilted = Surfels(**{**surfels.tensors(), "q_OS": q.expand(surfels.num_surfels, 4).contiguous().requires_grad_()})
    loss = normal_consistency(render(tilted, camera, FACING, backend="torch"), camera)
    # The surfels' normals are 40 degrees off the wall they make up, on the (H - 2)(W - 2) inner pixels.
    inner = (20 - 2) * (24 - 2) / (20 * 24)
    assert loss.item() == pytest.approx((1 - np.cos(np.deg2rad(40.0))) * inner, rel=0.35)
    loss.backward()
    assert tilted.q_OS.grad.abs().max() > 0.0


def test_distortion_is_that_of_two_walls():
    # Two half-transparent layers of opacity a: w = a, a (1 - a), so the mean is a^2 (1 - a) d^2.
    def layer(z):
        return torch.tensor([[0.0, 0.0, z]])

    p = torch.cat([layer(0.0), layer(0.1)])
    a = torch.tensor(0.4)
    surfels = Surfels(
        p, torch.tensor([[1.0, 0, 0, 0]] * 2), torch.full((2, 2), 3.0), torch.logit(a).expand(2), torch.zeros(2, 1, 3)
    )
    camera = Camera(4, 4, torch.tensor([60.0, 60.0, 2.0, 2.0]))
    loss = distortion_loss(render(surfels, camera, FACING, backend="torch"), length=0.2)
    assert loss.item() == pytest.approx(0.4**2 * 0.6 * 0.1**2 / 0.2**2, rel=1e-3)


def test_what_does_not_fit_is_named():
    a, b = images()
    with pytest.raises(RenderingError, match=r"images are \(23, 31, 3\) and \(22, 31, 3\)"):
        photometric(a, b[1:])
    with pytest.raises(RenderingError, match=r"images are .*; allowed: one shape"):
        ssim(a, b[1:])
    with pytest.raises(RenderingError, match=r"an image is \(23, 31\)"):
        ssim(a[..., 0], b[..., 0])
    with pytest.raises(RenderingError, match="kind is 'l3'; allowed: 'l1' or 'l2'"):
        photometric(a, b, kind="l3")
    with pytest.raises(RenderingError, match=r"dssim is 2\.0; allowed: 0 to 1"):
        photometric(a, b, dssim=2.0)
    bare = Rendering(a[None], a[None, ..., 0])
    with pytest.raises(RenderingError, match="full=True"):
        distortion_loss(bare)
    camera = Camera(31, 23, torch.tensor([60.0, 60.0, 12.0, 10.0]))
    with pytest.raises(RenderingError, match="full=True"):
        normal_consistency(bare, camera)
    whole = Rendering(a[None], a[None, ..., 0], a[None, ..., 0], a[None], a[None, ..., 0])
    with pytest.raises(RenderingError, match="31 x 23 px for a camera of 5 x 23 px"):
        normal_consistency(whole, Camera(5, 23, camera.intrinsics))
