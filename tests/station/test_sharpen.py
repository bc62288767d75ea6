# SPDX-License-Identifier: MIT
import numpy as np

from benchmarks.scenes.rendered_lab import RenderedLab
from pinwm_drake.spatial.rigid import apply, inverse, rigid
from pinwm_drake.station.board import Detector
from pinwm_drake.station.sharpen import Sharpener
from pinwm_drake.station.start import locate


def test_all_corners_of_a_small_oblique_board_are_found_without_bias():
    truth = RenderedLab(10)
    X_CM = inverse(truth.X_BC) @ truth._on_table(np.array([0.55, 0.05]), 0.5)
    grey = truth.draw(X_CM, truth.X_BC)
    first = Detector(truth.board).find(grey)
    near = locate(truth.lens, truth.board.corners_M[first.numbers], first.pixels)
    seen = Sharpener(truth.board, truth.lens).find(grey, near)
    assert len(seen.numbers) == 40
    off = seen.pixels - truth.lens.project(apply(X_CM, truth.board.corners_M[seen.numbers]))
    assert np.abs(off.mean(0)).max() < 0.05  # px; noise of 3 grey values leaves 0.1 px on a corner
    assert off.std() < 0.15


def test_corners_behind_a_hand_are_left_out():
    truth = RenderedLab(3)
    X_CM = rigid([-0.1, -0.08, 0.6])
    grey = truth.draw(X_CM, truth.X_BC)
    pixels = truth.lens.project(apply(X_CM, truth.board.corners_M))
    hidden = pixels[:, 0] < np.median(pixels[:, 0])
    grey[:, : int(np.median(pixels[:, 0]))] = 90
    seen = Sharpener(truth.board, truth.lens).find(grey, X_CM @ rigid([5e-4, 0, 0]))
    assert len(seen.numbers) >= 16
    assert not hidden[seen.numbers].any()
    assert Sharpener(truth.board, truth.lens).find(np.full_like(grey, 120), X_CM) is None
