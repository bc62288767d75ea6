# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.errors import SolverError
from pinwm_drake.spatial.rigid import apply, inverse, rigid
from pinwm_drake.station.board import Board
from pinwm_drake.station.bundle import Block, Bundle, Link, Noise, Photo
from tests.capture.test_lens import LENSES, OPENCV

G = np.random.default_rng(5)


def some_photos(lens, count=6):
    """Photos of each kind of chain, with poses near the truth."""
    corners = Board().corners_M
    camera, gripped = (
        Block(rigid([0.0, -0.8, 0.6], [-2.2, 0.1, 0.2])),
        Block(rigid([0.01, 0.02, 0.05], [0.3, 0.2, 0.1])),
    )
    table = Block(rigid([0.0, 0.0, 0.01], [0.01, 0.02, 0.0]), (2, 3, 4))
    photos = []
    for k in range(count):
        X_CM = rigid([*G.uniform(-0.15, 0.05, 2), G.uniform(0.5, 0.7)], G.uniform(-0.4, 0.4, 3))
        X_BE = camera.X @ X_CM @ inverse(gripped.X)
        chains = (
            (Link(camera, inverted=True), Link(Block(X_BE, told=X_BE @ rigid([1e-3, 0, 0]))), Link(gripped)),
            (Link(Block(X_CM)),),
            (Link(Block(inverse(X_CM @ inverse(table.X))), inverted=True), Link(table)),
        )
        pixels = lens.project(apply(X_CM, corners)) + G.normal(0.0, 0.1, (len(corners), 2))
        photos.append(Photo(str(k), corners, pixels, chains[k % 3]))
    return photos


@LENSES
def test_the_jacobian_is_that_of_central_differences(lens):
    bundle = Bundle(lens, some_photos(lens), Noise(0.1), 0.003)
    J, h = bundle.system().J, 1e-6
    for column in range(bundle.size):
        step = np.zeros(bundle.size)
        step[column] = h
        ahead, behind = [], []
        for sign, store in ((1.0, ahead), (-1.0, behind)):
            undo = bundle._move(sign * step)
            store.append(bundle.system().r)
            undo()
        difference = (ahead[0] - behind[0]) / (2 * h)
        scale = max(np.abs(difference).max(), 1.0)
        # Told poses are 1 mm off, where the derivative of a rotation vector is 1 to within 1e-3.
        np.testing.assert_allclose(J[:, column], difference, rtol=0, atol=2e-4 * scale)


def test_noises_and_scale_are_estimated():
    corners, lens = Board().corners_M, OPENCV
    camera, gripped = rigid([0.0, -0.8, 0.6], [-2.2, 0.1, 0.2]), rigid([0.01, 0.02, 0.05], [0.3, 0.2, 0.1])
    block, board = Block(camera @ rigid([2e-3, 0, 0])), Block(gripped @ rigid([0, 2e-3, 0]))
    photos = []
    for k in range(40):
        X_CM = rigid([*G.uniform(-0.2, 0.1, 2), G.uniform(0.4, 0.9)], G.uniform(-0.6, 0.6, 3))
        X_BE = camera @ X_CM @ inverse(gripped)
        told = X_BE @ rigid(G.normal(0, 5e-4, 3), G.normal(0, 1e-3, 3))
        pixels = lens.project(apply(X_CM, 1.002 * corners)) + G.normal(0.0, 0.1, (len(corners), 2))
        chain = Link(block, inverted=True), Link(Block(told.copy(), told=told)), Link(board)
        photos.append(Photo(str(k), corners, pixels, chain))
    bundle = Bundle(lens, photos, Noise(0.3, 2e-3, 2e-3), 0.01)
    for _ in range(8):
        bundle.adjust()
        bundle.estimate_noise()
    # 40 poses have 108 redundant numbers of each kind: 7 % of a standard deviation.
    np.testing.assert_allclose(bundle.noise.values(), [0.1, 5e-4, 1e-3], rtol=0.25)
    spread = np.sqrt(bundle.covariance()[bundle.num_lens, bundle.num_lens])
    assert abs(bundle.scale - 1.002) < 4.0 * spread
    np.testing.assert_allclose(block.X[:3, 3], camera[:3, 3], rtol=0, atol=2e-3)


def test_what_is_left_open_is_told():
    photos = some_photos(OPENCV, 1)  # one photo of the robot: camera and gripper can be anywhere
    with pytest.raises(SolverError, match="leave part of the calibration open"):
        Bundle(OPENCV, photos, Noise(0.1), 0.003).covariance()
