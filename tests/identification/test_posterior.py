# SPDX-License-Identifier: MIT
import pytest
import torch
import trimesh

from pinwm_drake.capture.scene import PusherGeometry
from pinwm_drake.identification.posterior import Posterior, estimates
from pinwm_drake.identification.unknowns import Coordinates
from pinwm_drake.scene import make_scene
from pinwm_drake.twin.drift import FINE_DRIFTS, chances
from tests.identification.samples import LEVEL, SHAPE

COORDINATES = Coordinates(("restitution_floor",), {})


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    mesh = tmp_path_factory.mktemp("cube") / "cube.obj"
    trimesh.creation.box((0.06, 0.06, 0.06)).export(mesh)
    return make_scene(mesh, PusherGeometry(None, SHAPE), q_WO=LEVEL, gravity=9.81)


@pytest.mark.parametrize(("width", "known"), [(0.01, True), (0.12, False)])
def test_a_restitution_of_zero_is_identified_where_its_interval_is_short(scene, width, known):
    draws = torch.randn(2000, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64).abs()
    scale = width / float(COORDINATES.values(torch.ones(1, 1, dtype=torch.float64))["restitution_floor"][0])
    draws = scale * draws
    posterior = Posterior.of(0.0 * draws[0], draws, chances(FINE_DRIFTS), torch.Generator().manual_seed(0))
    theta, _ = estimates(COORDINATES, posterior, scene, 1.0, True, 0)
    found = theta["restitution_floor"]
    assert found.value == 0.0
    assert found.interval == (0.0, pytest.approx(2.24 * width, rel=0.1))  # of a half-normal distribution
    assert found.identifiable == known
