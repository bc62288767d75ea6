# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
from torch.nn.functional import normalize

from pinwm_drake.rendering.harmonics import harmonics
from pinwm_drake.rendering.kernels.light import light_surfels


@pytest.mark.parametrize("degree", [0, 3])
def test_colours_keep_the_share_that_a_light_gives_to_their_normals_toward_the_camera(degree):
    torch.manual_seed(0)
    V, N, K = 3, 40, (degree + 1) ** 2
    sh, p, n = torch.randn(V, N, K, 3), 0.1 * torch.randn(N, 3), normalize(torch.randn(N, 3), dim=1)
    eyes, lights = torch.randn(V, 3), torch.randn(V, 4)
    lit = np.empty(sh.shape, np.float32)
    light_surfels(sh.numpy(), p.numpy(), n.numpy(), eyes.numpy(), lights.numpy(), lit, 0, V)
    way = normalize(eyes[:, None] - p, dim=2)
    basis = harmonics(way, degree)[..., None]

    def colours(values):
        return 0.5 + (basis * values).sum(2)

    facing = torch.where(((way * n).sum(2) < 0.0)[..., None], -n, n)
    share = (lights[:, None, 0] + (lights[:, None, 1:] * facing).sum(2)).clamp(min=0.0)
    assert 0.05 < (share == 0.0).float().mean() < 0.95
    torch.testing.assert_close(colours(torch.from_numpy(lit)), share[..., None] * colours(sh), atol=1e-5, rtol=1e-5)


def test_of_several_views_those_asked_for_are_lit_with_the_colours_that_all_share():
    sh, p, n = np.ones((1, 2, 4, 3), np.float32), np.zeros((2, 3), np.float32), np.eye(3, dtype=np.float32)[:2]
    lights = np.tile(np.float32([0.5, 0.25, 0.0, 0.0]), (3, 1))
    lit = np.full((3, 2, 4, 3), 7.0, np.float32)
    light_surfels(sh, p, n, np.ones((3, 3), np.float32), lights, lit, 1, 3)
    assert (lit[0] == 7.0).all()
    np.testing.assert_allclose(lit[1:, :, 1:], np.broadcast_to([[[0.75]], [[0.5]]], (2, 2, 3, 3)))
