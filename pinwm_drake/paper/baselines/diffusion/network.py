"""Network of diffusion policy: encoder and U-Net, the loss that trains them, and how they draw actions.

Sources: Ho et al., "Denoising diffusion probabilistic models" (NeurIPS 2020); Nichol and Dhariwal, "Improved denoising
diffusion probabilistic models" (ICML 2021) for the squared cosine; Song et al., "Denoising diffusion implicit models"
(ICLR 2021); Chi et al., "Diffusion policy" (RSS 2023).
"""

import importlib.util
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.baselines.diffusion.encoder import ImageEncoder
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions
from pinwm_drake.paper.baselines.diffusion.unet import TemporalUnet

_FLAT = 1e-4  # range of a component, below which it is not stretched
_SCHEDULE = {"beta_schedule": "squaredcos_cap_v2", "clip_sample": True, "prediction_type": "epsilon"}


class Stretch(nn.Module):
    """Stretch of each component of some data to [-1, 1], from its least and largest value.

    Attributes:
        middle: (n,) middle of the values.
        reach: (n,) half of their range; 1 where it is hardly any.
    """

    middle: Tensor
    reach: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("middle", torch.zeros(size))
        self.register_buffer("reach", torch.ones(size))

    def fit(self, values: Tensor) -> None:
        """Takes the range of values (m, n)."""
        low, high = values.amin(0), values.amax(0)
        self.middle.copy_(0.5 * (low + high))
        self.reach.copy_(torch.where(high - low > _FLAT, 0.5 * (high - low), 1.0))

    def forward(self, values: Tensor) -> Tensor:
        """Stretched values (..., n)."""
        return (values - self.middle) / self.reach

    def back(self, stretched: Tensor) -> Tensor:
        """Values (..., n) that were stretched."""
        return self.middle + self.reach * stretched


class DiffusionNetwork(nn.Module):
    """Network that tells the noise in sequences of actions, given the last images and positions of the pusher.

    Attributes:
        options: Settings of the network.
        action: Stretch of the actions.
        pusher: Stretch of the pusher's positions.
    """

    def __init__(self, options: NetworkOptions, action_size: int) -> None:
        """Makes the layers.

        Args:
            options: Settings of the network.
            action_size: Number of an action's components, n.
        """
        super().__init__()
        self.options = options
        self.action, self.pusher = Stretch(action_size), Stretch(action_size)
        self.encoder = ImageEncoder(options)
        self.unet = TemporalUnet(options, action_size, options.observations * (options.image_features + action_size))

    def condition(self, dark: Tensor, pusher: Tensor) -> Tensor:
        """Features (B, C) of what is seen; see `loss`."""
        count = self.options.observations
        features = self.encoder(dark.unflatten(1, (count, 3)).flatten(0, 1)).unflatten(0, (-1, count))
        return torch.cat([features, self.pusher(pusher)], 2).flatten(1)

    def loss(self, dark: Tensor, pusher: Tensor, action: Tensor) -> Tensor:
        """Mean squared error () of the noise, at steps of the diffusion that torch's generator draws.

        Args:
            dark: (B, 3 To, height, width) float32, 0 for white and 1 for black: the last images, the oldest first.
            pusher: (B, To, n) float32, along the task's axes across the pusher's box, -1 to 1.
            action: (B, Th, n) float32, in [-1, 1].
        """
        scheduler = _schedulers().DDPMScheduler(self.options.diffusion_steps, **_SCHEDULE)
        clean = self.action(action)
        # Drawn on the CPU, whose generator a checkpoint keeps.
        noise = torch.randn(clean.shape).to(clean)
        step = torch.randint(self.options.diffusion_steps, (len(clean),)).to(clean.device)
        noisy = scheduler.add_noise(clean, noise, step)
        return mse_loss(self.unet(noisy, step, self.condition(dark, pusher)), noise)

    @torch.no_grad()
    def sample(self, dark: Tensor, pusher: Tensor, noise: Tensor) -> Tensor:
        """Actions (B, Th, n) that DDIM makes of noise (B, Th, n); what is seen is as for `loss`."""
        scheduler = _schedulers().DDIMScheduler(self.options.diffusion_steps, **_SCHEDULE)
        scheduler.set_timesteps(self.options.sampling_steps)
        condition, found = self.condition(dark, pusher), noise
        for step in scheduler.timesteps:
            steps = torch.full((len(found),), int(step), device=found.device)
            found = scheduler.step(self.unet(found, steps, condition), step, found).prev_sample
        return self.action.back(found)


def require_diffusers() -> None:
    """Checks that diffusers is installed, which has the schedules of the noise.

    Raises:
        ParameterError: It is not.
    """
    if importlib.util.find_spec("diffusers") is None:
        given = "no package diffusers"
        raise ParameterError(f'diffusion policy: got {given}; allowed: after pip install "pinwm_drake[paper]"')


def _schedulers() -> Any:
    require_diffusers()
    import diffusers

    return diffusers
