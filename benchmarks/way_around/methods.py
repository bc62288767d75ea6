# SPDX-License-Identifier: MIT
"""Diffusion policy for a small problem, and the same network without the diffusion: regression to the mean."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from pinwm_drake.learning.images.augment import Augment
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.paper.baselines.diffusion.actor import DiffusionActor
from pinwm_drake.paper.baselines.diffusion.demonstrations import Episode, Windows
from pinwm_drake.paper.baselines.diffusion.method import DiffusionPolicy
from pinwm_drake.paper.baselines.diffusion.network import DiffusionNetwork
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions, TrainingOptions

ROUNDS = 8
NETWORK = NetworkOptions(widths=(32, 64), channels=(8, 16), keypoints=16, image_features=32, step_features=32)
TRAINING = TrainingOptions(batch_size=32, learning_rate=2e-3, warmup=100, shift=0)


def around_method(updates: int, rounds: int = ROUNDS) -> DiffusionPolicy:
    """Diffusion policy with a small network, for a number of updates in some rounds."""
    return DiffusionPolicy(NETWORK, replace(TRAINING, updates=updates, round_updates=max(1, updates // rounds)))


class MeanNetwork(DiffusionNetwork):
    """Network that tells the actions at once, and learns by their squared error."""

    def loss(self, dark: Tensor, pusher: Tensor, action: Tensor) -> Tensor:
        """Mean squared error () of the actions."""
        return mse_loss(self._tell(dark, pusher, torch.zeros_like(action)), self.action(action))

    @torch.no_grad()
    def sample(self, dark: Tensor, pusher: Tensor, noise: Tensor) -> Tensor:
        """Actions (B, Th, n), whatever the noise."""
        return self.action.back(self._tell(dark, pusher, torch.zeros_like(noise)))

    def _tell(self, dark: Tensor, pusher: Tensor, nothing: Tensor) -> Tensor:
        found: Tensor = self.unet(nothing, torch.zeros(len(nothing)), self.condition(dark, pusher))
        return found


def train_mean(episodes: list[Episode], spec: PolicySpec, method: DiffusionPolicy, seed: int) -> DiffusionActor:
    """Trains a policy by regression, with as many updates of as large a network as diffusion policy has."""
    options, training = method.network, method.training
    torch.manual_seed(seed)
    generator = np.random.default_rng(seed)
    windows = Windows(episodes, options.observations, options.horizon)
    network = MeanNetwork(options, spec.action_size)
    network.action.fit(torch.from_numpy(windows.action))
    network.pusher.fit(torch.from_numpy(windows.pusher))
    optimizer = torch.optim.AdamW(network.parameters(), training.learning_rate, weight_decay=training.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, training.updates)
    augment = Augment(training.shift, training.gain)
    for _ in range(training.updates):
        image, pusher, action = (torch.from_numpy(one) for one in windows.draw(training.batch_size, generator))
        loss = network.loss(augment(image), pusher, action)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return DiffusionActor(spec, network.eval(), seed)
