# SPDX-License-Identifier: MIT
import cv2
import numpy as np
import pytest

from pinwm_drake.capture.lens import Lens
from pinwm_drake.capture.remap import Remap, whole_view
from pinwm_drake.rendering.camera import Camera
from tests.capture.test_lens import LENSES, OPENCV

TURN = cv2.Rodrigues(np.array([0.1, -0.05, 0.15]))[0]


def ramps(lens):
    """Image whose values are its own columns and rows, px, centres at halves."""
    x, y = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
    return np.stack([x, y], -1).astype(np.float32)


@LENSES
@pytest.mark.parametrize("R_CV", [None, TURN], ids=["same axes", "turned"])
def test_a_pixel_shows_what_its_ray_meets(lens, R_CV):
    camera = Camera.from_field_of_view(256, 256, 0.5)
    remap = Remap(lens, camera, R_CV)
    found = remap(ramps(lens))[remap.seen]
    fx, fy, cx, cy = camera.intrinsics.tolist()
    x, y = np.meshgrid(np.arange(256) + 0.5, np.arange(256) + 0.5)
    rays = np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], -1) @ (np.eye(3) if R_CV is None else R_CV).T
    expected = lens.project(rays[remap.seen])
    inside = (expected > 1).all(1) & (expected < [lens.width - 1, lens.height - 1]).all(1)
    assert inside.mean() > 0.9
    # Maps have steps of 1/32 px, and their rounding is half of one on each axis.
    assert np.abs(found[inside] - expected[inside]).max() < 1 / 64 + 1e-3
    assert np.linalg.norm(found[inside] - expected[inside], axis=1).max() < 0.06


def test_what_the_lens_does_not_see_is_white():
    camera = Camera.from_field_of_view(64, 64, 2.0)  # wider than the lens
    remap = Remap(OPENCV, camera)
    image = remap(np.zeros((720, 1280, 3), np.uint8))
    assert not remap.seen[0, 0]
    assert remap.seen[32, 32]
    assert (image[0, 0] == 255).all()
    assert (image[32, 32] == 0).all()
    assert not remap.mask(np.ones((720, 1280), bool))[0, 0]


def test_coarse_views_average():
    # Stripes of one pixel are grey in a view of 16 times fewer columns.
    image = np.zeros((720, 1280), np.uint8)
    image[:, ::2] = 200
    lens = Lens(1280, 720, "opencv", np.array([1000.0, 1000.0, 640.0, 360.0]), np.zeros(5))
    found = Remap(lens, Camera.from_field_of_view(48, 48, 0.65))(image)
    assert 60 < found.mean() < 140
    assert found.std() < 60


def test_a_whole_view_shows_all_of_a_mask():
    lens = Lens(200, 200, "fisheye", np.array([80.0, 80.0, 100.0, 100.0]), np.zeros(4))
    mask = np.zeros((200, 200), bool)
    mask[90:110, 2:30] = True  # 70 degrees from the axis, which a pinhole of this focal length has not
    camera = whole_view(lens, mask)
    assert float(camera.intrinsics[0]) < 40.0
    x, y = np.meshgrid(np.arange(200) + 0.5, np.arange(200) + 0.5)
    rays = lens.rays(np.column_stack([x[mask], y[mask]]))
    pixels = rays * camera.intrinsics[:2].numpy() + camera.intrinsics[2:].numpy()
    assert (pixels >= 0).all()
    assert (pixels <= 200).all()
    middle = np.zeros((200, 200), bool)
    middle[95:105, 95:105] = True
    assert float(whole_view(lens, middle).intrinsics[0]) == 80.0
