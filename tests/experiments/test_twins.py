# SPDX-License-Identifier: MIT
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import pinwm_drake as pw
from pinwm_drake.capture.episode_tables import PusherTrajectory
from pinwm_drake.experiments import twins


class Asked(Exception):
    """Ends an identification where its search would begin."""


def test_the_surfels_of_another_twin_are_used_and_none_are_fitted(tmp_path, monkeypatch):
    asked = {}

    def identify_theta(capture, pushes, surfels, offset, options, *, X_OS, **others):
        asked.update(surfels=surfels, offset=offset, X_OS=X_OS, pushes=[push.name for push in pushes])
        raise Asked

    monkeypatch.setattr(twins, "identify_theta", identify_theta)
    shipped = pw.load_twin("t_block")
    with pytest.raises(Asked):
        twins.identify(pw.capture_path("t_block"), tmp_path / "twin", appearance=shipped)
    assert asked["surfels"] is shipped.surfels
    assert asked["offset"] == shipped.camera_offset
    assert asked["pushes"] == ["0000"]
    # The static views of this capture have the object where capture.yaml says.
    torch.testing.assert_close(asked["X_OS"].p, torch.zeros(3, dtype=torch.float64), atol=1e-12, rtol=0.0)
    torch.testing.assert_close(asked["X_OS"].q.abs(), torch.tensor([1.0, 0, 0, 0], dtype=torch.float64))
    assert not list((tmp_path / "twin").iterdir())


@pytest.mark.parametrize(("up", "told"), [(0.0, 0), (0.04, 1)])
def test_frictions_beyond_those_of_flips_are_told_after_pokes_alone(up, told):
    twin = pw.load_setup("flip_mug").with_theta(friction_floor=0.6).twin
    p_WP = np.array([[0.0, 0.0, 0.03], [0.1, 0.0, 0.03 + up]])
    way = PusherTrajectory(np.arange(2.0), p_WP, np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), np.zeros((2, 3)), None)
    found = twins.task_doubts(twin, [SimpleNamespace(trajectory=way)])
    assert len(found) == told
    assert all(one.startswith("friction_floor is 0.6; flip_mug is known") for one in found)
