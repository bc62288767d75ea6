# SPDX-License-Identifier: MIT
import math

import cv2
import numpy as np
import pytest
import trimesh

from pinwm_drake.errors import InputError
from pinwm_drake.report.figures.crosscheck import Differences, crosscheck_figure

BOX = trimesh.creation.box((0.1, 0.06, 0.05))


def draw(path, translations, *, thresholds=(0.003, 0.035)):
    t = np.linspace(0, 1, 5)
    ways = np.stack([0.1 * t, 0 * t, 0 * t], -1)
    unturned, turned = np.tile([1.0, 0, 0, 0], (5, 1)), np.tile([0.7, 0, 0, 0.7], (5, 1))
    crosscheck_figure(
        path,
        [
            Differences("hydroelastic", translations, [1e-3] * len(translations), True),
            Differences("point", [math.inf] * len(translations), [math.inf] * len(translations), False),
        ],
        thresholds=thresholds,
        mesh=BOX,
        worst=1,
        paths={"twin": (ways, unturned), "point": (ways, turned)},
        p_WP=ways,
        title="a push",
    )
    return cv2.imread(str(path))


def test_a_figure_is_drawn_whatever_the_numbers(tmp_path):
    image = draw(tmp_path / "a.png", [1e-3, math.inf, 0.0])
    assert image.std() > 5
    other = draw(tmp_path / "b.png", [5e-3, math.inf, 0.0])
    assert other.shape == image.shape
    # Another difference, another dot: of hundreds of pixels.
    assert (image != other).any(axis=2).sum() > 20


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(InputError, match="none"):
        draw(tmp_path / "none/a.png", [1e-3])
