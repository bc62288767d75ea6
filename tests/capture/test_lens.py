# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.capture.lens import Lens
from pinwm_drake.errors import RenderingError

OPENCV = Lens(1280, 720, "opencv", np.array([918.3, 916.9, 652.2, 352.9]), np.array([0.12, -0.28, 6e-4, -9e-4, 0.11]))
FISHEYE = Lens(1280, 720, "fisheye", np.array([500.0, 501.0, 640.0, 360.0]), np.array([0.02, -0.01, 0.003, -0.001]))
LENSES = pytest.mark.parametrize("lens", [OPENCV, FISHEYE], ids=["opencv", "fisheye"])


@LENSES
def test_rays_and_pixels_are_inverse(lens):
    pixels = np.random.default_rng(0).uniform([0, 0], [1280, 720], (500, 2))
    rays = lens.rays(pixels)
    again = lens.project(np.column_stack([rays, np.ones(500)]))
    np.testing.assert_allclose(again, pixels, rtol=0, atol=1e-9)  # OpenCV's iteration ends at 1e-12 of a ray


@LENSES
def test_the_centre_of_the_first_pixel_is_at_a_half(lens):
    middle = lens.project(np.array([[0.0, 0.0, 2.0]]))
    np.testing.assert_allclose(middle, lens.intrinsics[None, 2:], rtol=0, atol=1e-9)


@LENSES
def test_no_points_have_no_pixels(lens):
    pixels, by_point, by_lens = lens.project_with_jacobian(np.zeros((0, 3)))
    one = lens.project_with_jacobian(np.array([[0.0, 0.0, 1.0]]))
    assert [part.shape for part in (pixels, by_point, by_lens)] == [(0, *part.shape[1:]) for part in one]
    assert lens.project(np.zeros((0, 3))).shape == lens.rays(np.zeros((0, 2))).shape == (0, 2)


def test_a_fisheye_sees_angles():
    # f theta of a lens without distortion
    lens = Lens(1280, 720, "fisheye", np.array([400.0, 400.0, 640.0, 360.0]), np.zeros(4))
    seen = lens.project(np.array([[np.tan(1.0), 0.0, 1.0]]))
    np.testing.assert_allclose(seen, [[640.0 + 400.0, 360.0]], rtol=0, atol=1e-9)


@LENSES
def test_derivatives_are_those_of_central_differences(lens):
    p_C = np.random.default_rng(1).uniform(-0.3, 0.3, (6, 3)) + np.array([0.0, 0.0, 1.0])
    _, by_point, by_lens = lens.project_with_jacobian(p_C)
    h = 1e-6
    of_point = [(lens.project(p_C + d) - lens.project(p_C - d)) / (2 * h) for d in h * np.eye(3)]
    np.testing.assert_allclose(by_point, np.stack(of_point, -1), rtol=0, atol=1e-5)
    of_lens = []
    for d in h * np.eye(len(lens.parameters)):
        ahead, behind = (lens.with_parameters(lens.parameters + s * d).project(p_C) for s in (1, -1))
        of_lens.append((ahead - behind) / (2 * h))
    np.testing.assert_allclose(by_lens, np.stack(of_lens, -1), rtol=0, atol=1e-5)


def test_pixels_without_a_ray_have_none():
    # r (1 + k1 r^2) with k1 = -1 grows up to r = 0.577, where it is 0.385: no ray ends farther out.
    lens = Lens(100, 100, "opencv", np.array([100.0, 100.0, 50.0, 50.0]), np.array([-1.0, 0, 0, 0, 0]))
    found = lens.rays(np.array([[50.0, 50.0], [50.0 + 38.0, 50.0], [50.0 + 45.0, 50.0]]))
    assert np.isfinite(found[:2]).all()
    assert np.isnan(found[2]).all()


@pytest.mark.parametrize(
    ("model", "intrinsics", "distortion", "part"),
    [
        ("pinhole", [1, 1, 0, 0], [0] * 5, "pinhole"),
        ("opencv", [1, 1, 0], [0] * 5, "intrinsics"),
        ("opencv", [1, 1, 0, 0], [0] * 4, "5 or 8"),
        ("fisheye", [1, 1, 0, 0], [0, 0, 0, np.nan], "distortion"),
        ("fisheye", [1, 0, 0, 0], [0] * 4, "above 0"),
    ],
)
def test_wrong_lenses_are_refused(model, intrinsics, distortion, part):
    with pytest.raises(RenderingError, match=part):
        Lens(10, 10, model, intrinsics, distortion)
