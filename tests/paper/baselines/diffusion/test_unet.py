import pytest
import torch

from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions
from pinwm_drake.paper.baselines.diffusion.unet import TemporalUnet


@pytest.mark.parametrize(("widths", "horizon", "size"), [((16,), 5, 2), ((16, 24), 8, 3), ((16, 24, 32), 16, 2)])
def test_noise_has_the_shape_of_the_actions(widths, horizon, size):
    options = NetworkOptions(widths=widths, horizon=horizon, actions=2, step_features=16)
    unet = TemporalUnet(options, size, 7)
    noise = unet(torch.randn(4, horizon, size), torch.arange(4), torch.randn(4, 7))
    assert noise.shape == (4, horizon, size)
    noise.square().sum().backward()
    assert all(one.grad is not None and one.grad.abs().sum() > 0 for one in unet.parameters())


def test_each_sequence_is_told_by_its_own_step_and_condition():
    torch.manual_seed(0)
    unet = TemporalUnet(NetworkOptions(widths=(16, 24), step_features=16), 2, 7)
    noisy, step, condition = torch.randn(3, 16, 2), torch.tensor([5, 5, 5]), torch.randn(3, 7)
    before = unet(noisy, step, condition)
    other = condition.clone()
    other[1] += 1.0
    changed = (unet(noisy, step, other) - before).abs().amax((1, 2))
    assert changed[1] > 1e-3
    assert changed[[0, 2]].max() < 1e-5
    changed = (unet(noisy, torch.tensor([5, 5, 60]), condition) - before).abs().amax((1, 2))
    assert changed[2] > 1e-3
    assert changed[:2].max() < 1e-5


def test_a_block_scales_and_shifts_its_channels_by_the_condition():
    torch.manual_seed(0)
    block = TemporalUnet(NetworkOptions(widths=(16,), step_features=16), 2, 7).middle[0]
    x, given = torch.randn(2, 16, 16), torch.randn(2, 23)
    with torch.no_grad():
        block.film[1].weight.zero_()
        block.film[1].bias.copy_(torch.cat([torch.full((16,), 3.0), torch.full((16,), -2.0)]))
    assert torch.allclose(block(x, given), block.second(3.0 * block.first(x) - 2.0) + x, atol=1e-5)
