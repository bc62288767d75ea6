# SPDX-License-Identifier: MIT
import dataclasses

import numpy as np
import pytest

from pinwm_drake.control.image_rules import ImageRules
from pinwm_drake.learning.spec import CameraSpec

SIZE, FOCAL, HEIGHT = 64, 64.0, 1.0
# Looks straight down from 1 m: a pixel is 1/64 m; x of the image is x of the world, y is -y.
CAMERA = CameraSpec(SIZE, SIZE, FOCAL, FOCAL, SIZE / 2, SIZE / 2, (0.0, 0.0, HEIGHT), (0.0, 1.0, 0.0, 0.0))
BOX, SPEED = ((-0.3, -0.3), (0.3, 0.3)), 0.2


def picture(u=32, v=32, side=10, shade=90):
    """A dark square of `side` px around (u, v)."""
    image = np.full((SIZE, SIZE, 3), 255, np.uint8)
    image[v - side // 2 : v + side // 2, u - side // 2 : u + side // 2] = shade
    return image


def rules(live=True, pixels=(80, 120)):
    return ImageRules(CAMERA, 0.0, BOX, SPEED, pixels, live)


def fault(first, second=None, dt=0.1, moving=True, **options):
    one = rules(**options)
    last = one.sight(first, 1.0)
    if second is None:
        return one.fault(last, None, moving)
    assert one.fault(last, None, moving) == ""
    return one.fault(one.sight(second, 1.0 + dt), last, moving)


def test_a_sight_is_where_the_object_is_on_the_floor():
    sight = rules().sight(picture(40, 20), 1.5)
    assert (sight.time, sight.pixels) == (1.5, 100)
    np.testing.assert_allclose(sight.p_W, [8 / 64, 12 / 64], atol=1e-12)
    empty = rules().sight(np.full((SIZE, SIZE, 3), 255, np.uint8), 0.0)
    assert empty.pixels == 0
    assert np.isnan(empty.p_W).all()


def test_a_camera_that_looks_askance_finds_the_same_place():
    # 0.5 m above and 0.5 m before the origin, at which it looks: turned by 45 degrees about x from straight down.
    half = np.pi * 3 / 8
    camera = dataclasses.replace(CAMERA, p_WC=(0.0, -0.5, 0.5), q_WC=(np.cos(half), -np.sin(half), 0.0, 0.0))
    sight = ImageRules(camera, 0.0, BOX, SPEED, None, True).sight(picture(), 0.0)
    np.testing.assert_allclose(sight.p_W, [0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("images", "words"),
    [
        ((np.full((SIZE, SIZE, 3), 255, np.uint8),), "image is blind: 0 px"),
        ((picture(side=2),), "image is blind: 4 px of the object; allowed: 16 or more"),
        ((picture(side=16),), "image is implausible: 256 px of the object; allowed: at most 204"),
        ((picture(60, 32, 8),), "image is implausible: the object at (0.438, 0.000) m"),
        ((picture(), picture()), "image is frozen: the same pixels as 0.100 s before"),
        ((picture(), picture(40, 32)), "image is implausible: the object jumped by 125 mm; allowed: 90 mm in 0.100 s"),
    ],
)
def test_what_cannot_be_is_a_fault(images, words):
    assert fault(*images).startswith(words)


def test_what_can_be_is_none():
    assert fault(picture()) == ""
    # An arm hides three quarters of it.
    assert fault(picture(), picture(side=6)) == ""
    assert fault(picture(), picture(shade=91)) == ""
    assert fault(picture(), picture(37, 32)) == ""
    # More time, more way.
    assert fault(picture(), picture(40, 32), dt=0.2) == ""
    # The same image, of a pusher that stands still, and of a camera without noise.
    assert fault(picture(), picture(), moving=False) == ""
    assert fault(picture(), picture(), live=False) == ""


def test_without_golden_samples_only_what_is_empty_is_blind():
    assert fault(picture(side=2), pixels=None) == ""
    assert fault(picture(side=18), pixels=None) == ""
    assert "blind" in fault(np.full((SIZE, SIZE, 3), 255, np.uint8), pixels=None)
