# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import torch

from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import InputError
from pinwm_drake.identification.expansion import corrected, deviation
from pinwm_drake.identification.locate import locate
from tests.identification.samples import surfels, write_capture
from tests.twin.samples import cube_twin


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The first capture of a cube, and a twin that has its appearance."""
    folder = tmp_path_factory.mktemp("locate")
    capture = load_capture(write_capture(folder / "capture"))
    twin = cube_twin(folder, mesh_path=capture.object.mesh_path, pusher=capture.pusher, surfels=surfels())
    return capture, read_episode(capture, "0000"), twin


@pytest.mark.parametrize("change", [(0.0, 0.0, 0.0), (6.0, -4.0, 3.0), (-8.0, 7.0, -5.0)])
def test_the_start_is_found_in_the_first_picture(scene, change):
    capture, episode, twin = scene
    X_WO = capture.object.X_WO
    x, y, yaw = change[0] * 1e-3, change[1] * 1e-3, math.radians(change[2])
    d = torch.tensor([0.0, 0.0, yaw, x, y, 0.0], dtype=torch.float64)
    found = locate(twin, episode, corrected(X_WO, d), num_threads=1)
    left = deviation(found, X_WO).numpy()
    # Within a pixel of these pictures, which is 2 mm wide, and the same from everywhere.
    assert np.linalg.norm(left[3:]) < 2e-3
    assert abs(left[2]) < math.radians(0.5)
    assert left[[0, 1, 5]] == pytest.approx(0.0, abs=1e-12)
    again = deviation(locate(twin, episode, X_WO, num_threads=1), found).numpy()
    assert np.linalg.norm(again[3:]) < 2e-4


def test_an_object_that_is_elsewhere_is_refused(scene):
    capture, episode, twin = scene
    d = torch.tensor([0.0, 0.0, 0.0, 0.03, 0.0, 0.0], dtype=torch.float64)
    with pytest.raises(InputError, match="away from where it should be"):
        locate(twin, episode, corrected(capture.object.X_WO, d), num_threads=1)
