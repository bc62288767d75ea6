import importlib.util
import math

import pytest
import torch

from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.baselines.diffusion import network as network_module
from pinwm_drake.paper.baselines.diffusion.network import DiffusionNetwork, Stretch, require_diffusers
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions

SMALL = NetworkOptions(widths=(16, 24), channels=(8,), keypoints=4, image_features=8, step_features=16)
needs_diffusers = pytest.mark.skipif(importlib.util.find_spec("diffusers") is None, reason="no diffusers here")


def test_a_stretch_goes_from_least_to_largest_and_back():
    torch.manual_seed(0)
    values = torch.rand(50, 3) * torch.tensor([0.2, 1.0, 0.0]) + torch.tensor([0.3, -0.5, 0.7])
    stretch = Stretch(3)
    stretch.fit(values)
    found = stretch(values)
    assert found[:, :2].amin(0).tolist() == pytest.approx([-1.0, -1.0], abs=1e-5)
    assert found[:, :2].amax(0).tolist() == pytest.approx([1.0, 1.0], abs=1e-5)
    assert torch.equal(found[:, 2], torch.zeros(50))  # always the same value
    assert torch.allclose(stretch.back(found), values, atol=1e-6)
    assert set(stretch.state_dict()) == {"middle", "reach"}


class Known(torch.nn.Module):
    """The noise in actions whose clean ones are known."""

    def __init__(self, clean, steps):
        super().__init__()
        angles = (torch.arange(steps + 1) / steps + 0.008) / 1.008 * math.pi / 2
        bars = angles.cos() ** 2  # Nichol and Dhariwal, eq. 17
        betas = (1.0 - bars[1:] / bars[:-1]).clamp(max=0.999)
        self.clean, self.kept = clean, (1.0 - betas).cumprod(0)

    def forward(self, noisy, step, condition):
        kept = self.kept[step][:, None, None]
        return (noisy - kept.sqrt() * self.clean) / (1.0 - kept).sqrt()


@needs_diffusers
def test_the_noise_of_a_known_sequence_is_taken_away():
    torch.manual_seed(0)
    network = DiffusionNetwork(SMALL, 2)
    network.action.fit(torch.tensor([[-0.5, 0.0], [0.5, 0.2]]))
    clean = 2.0 * torch.rand(3, 16, 2) - 1.0
    network.unet = Known(clean, SMALL.diffusion_steps)
    dark, pusher = torch.rand(3, 6, 16, 16), torch.rand(3, 2, 2)
    found = network.sample(dark, pusher, torch.randn(3, 16, 2))
    # DDIM's last step gives the clean sequence that the network has told; float32 beside sqrt(kept) of 0.1 at first.
    assert torch.allclose(found, network.action.back(clean), atol=1e-4)
    # The schedule of the loss is that one too: a network that knows the noise has no loss.
    assert network.loss(dark, pusher, network.action.back(clean)) < 1e-6


@needs_diffusers
def test_a_loss_reaches_every_weight_and_sees_every_input():
    torch.manual_seed(0)
    network = DiffusionNetwork(SMALL, 2)
    dark, pusher, action = torch.rand(4, 6, 16, 16), torch.rand(4, 2, 2), torch.rand(4, 16, 2)
    network.loss(dark, pusher, action).backward()
    assert all(one.grad is not None for one in network.parameters())
    before = network.condition(dark, pusher)
    for k in (0, 3):  # a channel of the older image, and one of the newer
        changed = dark.clone()
        changed[:, k] = 0.0
        assert (network.condition(changed, pusher) - before).abs().amax() > 1e-3
    assert not torch.equal(network.condition(dark, pusher + 0.1), before)


def test_without_diffusers_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(network_module.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ParameterError, match=r"pinwm_drake\[diffusion\]"):
        require_diffusers()
