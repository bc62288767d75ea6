# SPDX-License-Identifier: MIT
import numpy as np
import torch
from torch.nn.functional import interpolate

from pinwm_drake.rendering.kernels.light import relight


def test_what_is_shown_is_lit_as_torch_interpolates_the_light_and_white_stays_white():
    generator = np.random.default_rng(0)
    image = generator.integers(0, 255, (4, 11, 7, 6), np.uint8)
    image[:, 3:5] = 255
    factors = generator.uniform(0.7, 1.3, (4, 3)).astype(np.float32)
    shade = generator.uniform(0.2, 1.0, (4, 2, 3, 3)).astype(np.float32)
    changed = image.copy()
    relight(changed, factors, shade)
    light = interpolate(torch.from_numpy(shade), (11, 7), mode="bilinear", align_corners=True)
    light = light.numpy().transpose(0, 2, 3, 1).repeat(3, axis=3)
    expected = np.clip(255.0 - np.tile(factors, 2)[:, None, None] * (255.0 - light * image), 0.0, 255.0)
    expected[:, 3:5] = 255.0
    np.testing.assert_allclose(changed, expected, atol=0.5 + 1e-3)
    assert np.abs(changed.astype(float) - image).mean() > 20.0
