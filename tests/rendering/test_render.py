# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import scipy.special
import torch

from pinwm_drake.errors import RenderingError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.harmonics import harmonics
from pinwm_drake.rendering.render import narrow_disc, narrow_width, render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose, compose, inverse
from pinwm_drake.spatial.rotations import quaternion_exp
from tests.rendering.scenes import ahead, around, camera, cloud, join, leaves, loss, parts, single

BACKENDS = pytest.mark.parametrize("backend", ["numba", "torch"])
FULL = pytest.mark.parametrize("full", [False, True])


@FULL
@pytest.mark.parametrize(("degree", "own"), [(3, True), (0, False), (1, False), (2, False)])
@pytest.mark.parametrize("disc", [math.sqrt(0.5), torch.tensor([0.4, 1.5, 0.1])])
def test_kernels_agree_with_the_reference(full, degree, own, disc):
    V = 3
    X_CO = around(V)
    cameras = Camera(45, 37, torch.stack([camera(focal=50.0 + 10.0 * v).intrinsics for v in range(V)]))
    background = torch.tensor([0.2, 0.5, 0.9])
    surfels = cloud(degree=degree, views=V if own else None, dtype=torch.float64)
    results = {}
    for backend, dtype in (("torch", torch.float64), ("numba", torch.float32)):
        leaf, pose = leaves(surfels.to(dtype=dtype), X_CO)
        rendering = render(leaf, cameras, pose, full=full, background=background, disc=disc, backend=backend)
        loss(rendering).backward()
        gradients = {**{name: value.grad for name, value in leaf.tensors().items()}, "q": pose.q.grad, "p": pose.p.grad}
        results[backend] = parts(rendering), gradients
    for name, expected in results["torch"][0].items():
        found = results["numba"][0][name]
        assert found.dtype == torch.float32
        atol = 1e-7 if name == "distortion" else 2e-5
        torch.testing.assert_close(found.detach().double(), expected.detach(), atol=atol, rtol=0.0, msg=name)
    for name, expected in results["torch"][1].items():
        error = (results["numba"][1][name].double() - expected).abs().max() / expected.abs().max()
        # Single precision against double, over a sum of thousands of pixels.
        assert error < 3e-4, (name, float(error))


@FULL
def test_the_references_gradients_are_those_of_finite_differences(full):
    # Opacities away from the limits 1/255 and 0.99, where the image itself jumps or bends.
    surfels = join([((0.01, 0.0, 0.02), (0.9, 0.3, 0.2, 0.1), (0.03, 0.02), 0.7, (0.9, 0.4, 0.1)),
                    ((-0.01, 0.01, 0.0), (0.8, -0.3, 0.4, 0.1), (0.02, 0.04), 0.6, (0.2, 0.7, 0.8)),
                    ((0.0, -0.02, -0.03), (0.7, 0.2, -0.5, 0.3), (0.015, 0.02), 0.8, (0.3, 0.3, 0.9))])  # fmt: skip
    surfels = surfels.to(dtype=torch.float64)
    X_CO = ahead(0.4)
    # Pixels in the middle only: farther out, surfels fade through 1/255.
    view = camera(focal=400.0).cropped(14, 10, 16, 14)

    def value(tensors, q, p):
        return loss(render(Surfels(**tensors), view, Pose(q, p), full=full, backend="torch"))

    leaf, pose = leaves(surfels, X_CO)
    value(leaf.tensors(), *pose).backward()
    step = 1e-6
    for name in (*leaf.tensors(), "q", "p"):
        tensor = getattr(leaf, name) if name in leaf.tensors() else getattr(pose, name)
        numbers = tensor.detach().flatten()
        differences = torch.zeros_like(numbers)
        for i in range(len(numbers)):
            ends = []
            for sign in (1.0, -1.0):
                moved = numbers.clone()
                moved[i] += sign * step
                tensors = {key: item.detach() for key, item in leaf.tensors().items()}
                poses = {"q": pose.q.detach(), "p": pose.p.detach()}
                (tensors if name in tensors else poses)[name] = moved.reshape(tensor.shape)
                ends.append(value(tensors, poses["q"], poses["p"]))
            differences[i] = (ends[0] - ends[1]) / (2.0 * step)
        scale = differences.abs().max()
        gradient = tensor.grad.flatten()
        assert (gradient - differences).abs().max() < 1e-6 * scale, name


@BACKENDS
def test_one_surfel_is_a_gaussian_in_its_plane(backend):
    focal, distance = 200.0, 0.5
    view = Camera(41, 41, torch.tensor([focal, focal, 20.5, 20.5]))
    rendering = render(single(), view, ahead(distance), backend=backend, background=torch.zeros(3))
    offsets = (torch.arange(41) - 20.0) * distance / focal
    y, x = torch.meshgrid(offsets, offsets, indexing="ij")
    alpha = 0.8 * torch.exp(-0.5 * ((x / 0.02) ** 2 + (y / 0.01) ** 2))
    alpha = torch.where(alpha > 1.0 / 255.0, alpha, 0.0)
    torch.testing.assert_close(rendering.alpha[0], alpha, atol=2e-6, rtol=0.0)
    torch.testing.assert_close(rendering.color[0], alpha[..., None] * torch.tensor([0.9, 0.4, 0.1]), atol=3e-6, rtol=0)
    torch.testing.assert_close(rendering.depth[0], alpha * distance, atol=2e-6, rtol=0.0)
    torch.testing.assert_close(rendering.normal[0, 20, 20], torch.tensor([0.0, 0.0, -0.8]), atol=2e-6, rtol=0.0)
    assert rendering.distortion.abs().max() < 1e-8


@BACKENDS
def test_a_tilted_surfel_has_the_depth_of_its_plane(backend):
    angle, distance = 0.7, 0.5
    q = (math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0)
    view = Camera(64, 64, torch.tensor([300.0, 300.0, 32.0, 32.0]))
    rendering = render(single(q=q, scale=(0.05, 0.05)), view, ahead(distance), backend=backend)
    seen = rendering.alpha[0] > 0.1
    # The plane's normal is (sin, 0, cos): x sin + (z - distance) cos = 0 along the ray (x / z, y / z, 1).
    ray = (torch.arange(64) + 0.5 - 32.0) / 300.0
    depth = distance * math.cos(angle) / (ray * math.sin(angle) + math.cos(angle))
    found = rendering.depth[0] / rendering.alpha[0]
    torch.testing.assert_close(found[seen], depth.expand(64, 64)[seen], atol=1e-5, rtol=0.0)


@BACKENDS
def test_two_surfels_blend_front_to_back(backend):
    near, far = (0.0, 0.0, -0.1), (0.0, 0.0, 0.1)
    still = (1.0, 0.0, 0.0, 0.0)
    items = [(far, still, (0.05, 0.05), 0.5, (0.0, 1.0, 0.0)), (near, still, (0.05, 0.05), 0.6, (1.0, 0.0, 0.0))]
    view = Camera(1, 1, torch.tensor([100.0, 100.0, 0.5, 0.5]))
    for order in (items, items[::-1]):
        rendering = render(join(order), view, ahead(0.5), backend=backend)
        w1, w2 = 0.6, 0.4 * 0.5
        left = 1.0 - w1 - w2
        expected = {"color": [w1 + left, w2 + left, left], "alpha": w1 + w2, "depth": w1 * 0.4 + w2 * 0.6}
        expected |= {"normal": [0.0, 0.0, -w1 - w2], "distortion": w1 * w2 * 0.2**2}
        for name, value in expected.items():
            found = getattr(rendering, name)[0, 0, 0]
            torch.testing.assert_close(found, torch.tensor(value), atol=2e-6, rtol=0.0)


@BACKENDS
def test_what_is_behind_the_camera_is_not_seen_and_what_is_edge_on_is_a_pixel_wide(backend):
    view = Camera(32, 32, torch.tensor([100.0, 100.0, 16.0, 16.0]))
    assert render(single(), view, ahead(-0.5), backend=backend).alpha.max() == 0.0
    assert render(single(), view, ahead(0.005), backend=backend).alpha.max() == 0.0
    edge = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)  # its normal is across the line of sight
    alpha = render(single(q=edge, scale=(1e-3, 1e-3)), view, ahead(0.5), backend=backend).alpha[0]
    assert alpha.max() > 0.4
    # exp(-|x|^2) reaches 1 / 255 / 0.8 at 2.3 px.
    rows, columns = np.nonzero(alpha.numpy())
    assert np.hypot(rows - 15.5, columns - 15.5).max() < 2.3
    assert len(rows) == 16


@BACKENDS
def test_colours_turn_with_the_object(backend):
    surfels, X_CO, view = cloud(), around(1), camera()
    turn = Pose(quaternion_exp(torch.tensor([[0.3, -0.8, 0.5]], dtype=torch.float64)), torch.zeros(1, 3).double())
    # Object and camera turn together: the image stays.
    X_WC = inverse(X_CO)
    moved = compose(inverse(compose(turn, X_WC)), turn)
    first = render(surfels, view, X_CO, backend=backend).color
    second = render(surfels, view, moved, backend=backend).color
    torch.testing.assert_close(first, second, atol=1e-5, rtol=0.0)


def test_many_views_with_colours_of_their_own_are_one_call():
    V = 32
    surfels, X_CO, view = cloud(views=V), around(V), camera(64, 64)
    together = render(surfels, view, X_CO)
    for v in range(V):
        tensors = surfels.tensors() | {"sh": surfels.sh[v]}
        alone = render(Surfels(**tensors), view, Pose(X_CO.q[v], X_CO.p[v]))
        for name, image in parts(alone).items():
            assert torch.equal(image[0], parts(together)[name][v]), name


@FULL
def test_threads_change_nothing(full):
    results = []
    for threads in (1, 2, 5):
        leaf, pose = leaves(cloud(500), around(1))
        rendering = render(leaf, camera(330, 250, 500.0), pose, full=full, num_threads=threads)
        loss(rendering).backward()
        results.append((parts(rendering), leaf.p_OS.grad, pose.p.grad))
    for images, p_bar, t_bar in results[1:]:
        for name, image in images.items():
            assert torch.equal(image, results[0][0][name]), name
        torch.testing.assert_close(p_bar, results[0][1], atol=1e-5 * float(p_bar.abs().max()), rtol=0.0)
        torch.testing.assert_close(t_bar, results[0][2], atol=1e-5 * float(t_bar.abs().max()), rtol=0.0)
    # The same number of threads gives the same bits.
    again, pose = leaves(cloud(500), around(1))
    loss(render(again, camera(330, 250, 500.0), pose, full=full, num_threads=5)).backward()
    assert torch.equal(again.p_OS.grad, results[-1][1])


def test_absurd_surfels_do_no_harm():
    surfels = cloud(64)
    tensors = {name: value.clone() for name, value in surfels.tensors().items()}
    bad = [float("nan"), float("inf"), float("-inf"), 1e30, -1e30, 80.0]
    for i, value in enumerate(bad):
        for j, name in enumerate(("p_OS", "q_OS", "log_scale", "logit_opacity")):
            tensors[name].view(64, -1)[8 * j + i, 0] = value
    tensors["q_OS"][40] = 0.0
    rendering = render(Surfels(**tensors), camera(), around(2))
    assert tuple(rendering.color.shape) == (2, 37, 45, 3)
    assert bool(torch.isfinite(rendering.alpha).all())
    with pytest.raises(RenderingError, match=r"p_OS\[0, 0\] is nan"):
        Surfels(**tensors).check()


def test_no_surfels_show_the_background():
    for backend in ("numba", "torch"):
        rendering = render(cloud(0), camera(), around(2), backend=backend, background=torch.tensor([0.1, 0.2, 0.3]))
        assert torch.equal(rendering.color[1, 3, 4], torch.tensor([0.1, 0.2, 0.3]))
        assert rendering.alpha.abs().max() == 0.0


def test_harmonics_are_the_real_spherical_harmonics():
    generator = torch.Generator().manual_seed(0)
    d = torch.nn.functional.normalize(torch.randn(50, 3, generator=generator, dtype=torch.float64), dim=-1)
    found = harmonics(d, 3).numpy()
    x, y, z = d.numpy().T
    polar, azimuth = np.arccos(z), np.arctan2(y, x)
    column = 0
    for degree in range(4):
        for m in range(-degree, degree + 1):
            Y = scipy.special.sph_harm_y(degree, abs(m), polar, azimuth)
            # 3DGS keeps the Condon-Shortley sign that the usual real harmonics drop.
            value = Y.real if m == 0 else math.sqrt(2.0) * (Y.imag if m < 0 else Y.real)
            np.testing.assert_allclose(found[:, column], value, atol=1e-12, err_msg=f"{degree}, {m}")
            column += 1


def test_input_that_does_not_fit_is_refused():
    surfels, view, X_CO = cloud(views=2), camera(), around(2)
    with pytest.raises(RenderingError, match="'cuda'"):
        render(surfels, view, X_CO, backend="cuda")
    with pytest.raises(RenderingError, match=r"sh is \(2, 60, 16, 3\)"):
        render(surfels, view, around(3))
    with pytest.raises(RenderingError, match="X_CO is"):
        render(surfels, view, Pose(X_CO.q, X_CO.p[:1]))
    with pytest.raises(RenderingError, match="intrinsics are"):
        render(surfels, Camera(8, 8, view.intrinsics.expand(3, 4)), X_CO)
    with pytest.raises(RenderingError, match="background is"):
        render(surfels, view, X_CO, background=torch.ones(4))
    with pytest.raises(RenderingError, match="log_scale is"):
        render(Surfels(**surfels.tensors() | {"log_scale": torch.zeros(60, 3)}), view, X_CO)
    with pytest.raises(RenderingError, match="width is 0"):
        Camera(0, 8, view.intrinsics)
    with pytest.raises(RenderingError, match="fx, fy positive"):
        Camera(8, 8, torch.tensor([0.0, 1.0, 4.0, 4.0]))


def test_cameras_scale_and_crop():
    surfels, X_CO, view = cloud(), around(1), camera(48, 40, 80.0)
    image = render(surfels, view, X_CO).color[0]
    part = render(surfels, view.cropped(11, 7, 20, 16), X_CO).color[0]
    torch.testing.assert_close(part, image[7:23, 11:31], atol=1e-5, rtol=0.0)
    half = view.scaled(0.5)
    assert (half.width, half.height) == (24, 20)
    torch.testing.assert_close(half.intrinsics, view.intrinsics / 2)
    wide = Camera.from_field_of_view(30, 20, math.pi / 2)
    torch.testing.assert_close(wide.intrinsics, torch.tensor([10.0, 10.0, 15.0, 10.0]).double())


def test_a_change_in_place_between_forward_and_backward_is_an_error():
    surfels = cloud(degree=0)
    leaf, _ = leaves(surfels, ahead(0.4))
    color = render(leaf, camera(), ahead(0.4), num_threads=1).color
    with torch.no_grad():
        leaf.p_OS.add_(0.01)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        color.mean().backward()


def test_a_pose_that_is_no_number_is_refused():
    X_CO = ahead(0.4, 0.5)
    X_CO.p[1, 2] = math.nan
    with pytest.raises(RenderingError, match="X_CO of view 1"):
        render(cloud(degree=0), camera(), X_CO)


def test_a_narrow_disc_shows_what_a_finer_image_has_at_the_middles_of_pixels():
    surfels, X_CO = cloud(number=400), around(2)
    small = Camera(9, 7, torch.tensor([20.0, 20.0, 4.6, 3.3]))
    fine = Camera(81, 63, 9.0 * small.intrinsics)
    disc = narrow_disc(narrow_width(surfels), small, X_CO.p[:, 2])
    assert disc.shape == (2,)
    assert bool((disc < math.sqrt(0.5)).all())
    shown = render(surfels, small, X_CO, disc=disc)
    wanted = render(surfels, fine, X_CO, disc=9.0 * disc)
    for name, image in parts(shown).items():
        torch.testing.assert_close(image, getattr(wanted, name)[:, 4::9, 4::9], atol=1e-5, rtol=1e-4, msg=name)


def test_a_narrow_disc_is_the_usual_one_where_surfels_are_larger_than_pixels():
    width = narrow_width(single(scale=(0.02, 0.01)))
    assert width == pytest.approx(0.01)
    assert narrow_disc(width, camera(focal=6000.0), torch.tensor([0.5])).tolist() == [math.sqrt(0.5)]
    found = narrow_disc(width, camera(focal=60.0), torch.tensor([2.0, -1.0, math.nan]))
    assert found[0] == pytest.approx(0.01 * math.sqrt(60.0 * 61.8) / 2.0)
    assert found[1:].tolist() == 2 * [math.sqrt(0.5)]  # not ahead of the camera: as near as may be


def test_the_narrow_width_is_that_of_the_narrow_side_of_the_tenth_of_surfels():
    sides = [0.001 * (k + 1) for k in range(20)]
    surfels = join([((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.03, side), 0.5, (1.0, 0.0, 0.0)) for side in sides])
    assert narrow_width(surfels) == pytest.approx(0.002)


@BACKENDS
@pytest.mark.parametrize("disc", [0.0, -1.0, math.nan, torch.ones(2)])
def test_discs_that_are_none_are_refused(backend, disc):
    with pytest.raises(RenderingError, match="disc"):
        render(cloud(), camera(), ahead(0.4), disc=disc, backend=backend)
