"""Networks of policies: from an observation to an action in [-1, 1]^n.

A network gives logits of a few levels for each component of an action. The action is the mean of the likeliest level
and its neighbours, weighted by their probabilities. A network that gave numbers would give the mean of two good ways
around an object, which is none, and stand still there.

Source: Tang and Agrawal, "Discretizing continuous action space for on-policy optimization" (AAAI 2020).
"""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor, nn

from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.tasks import Task

LEVELS = tuple(k / 3.0 for k in range(-3, 4))
Seen = Tensor | Mapping[str, Tensor]


def chosen(logits: Tensor) -> Tensor:
    """Actions (B, n) of logits (B, n, len(LEVELS)): the weighted mean of the likeliest level and its neighbours.

    NaN where logits are NaN.
    """
    levels = torch.tensor(LEVELS, device=logits.device)
    numbers = torch.arange(len(LEVELS), device=logits.device)
    far = (numbers - logits.argmax(-1, keepdim=True)).abs() > 1
    actions: Tensor = logits.masked_fill(far, -torch.inf).softmax(-1) @ levels
    return actions


class StateActor(nn.Module):
    """Network from the state (B, state_size) to an action: two hidden layers of tanh.

    Attributes:
        latent_size: Width of the last hidden layer.
        head: Linear layer to the logits of the action's levels, those of the first component first.
    """

    def __init__(self, task: Task, width: int = 256) -> None:
        """Builds hidden layers of a width for a task's state and action."""
        super().__init__()
        self.latent_size, self._components = width, task.action_size
        self.body = nn.Sequential(nn.Linear(task.state_size, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh())
        self.head = nn.Linear(width, task.action_size * len(LEVELS))

    def latent(self, seen: Seen) -> Tensor:
        """Last hidden layer (B, latent_size) of an observation: the state, or a dict with `state`."""
        state = seen["state"] if isinstance(seen, Mapping) else seen
        latent: Tensor = self.body(state)
        return latent

    def logits(self, seen: Seen) -> Tensor:
        """Logits (B, n, len(LEVELS)) of an observation."""
        logits: Tensor = self.head(self.latent(seen)).unflatten(1, (self._components, -1))
        return logits

    def forward(self, state: Tensor) -> Tensor:
        """Actions (B, n) of states (B, state_size) float32."""
        return chosen(self.logits(state))


class ImageActor(nn.Module):
    """Network from images and the pusher's position to an action, by way of an estimate of the state.

    Between the two stands a state as `StateActor` takes it, so that what was learned from the state can be taken over.
    The task says what of it has to be estimated (`Task.assembly`).
    The convolutions have strides of 4, 2 and 1, so that what is left tells where things are.

    Attributes:
        actor: Network from the state to the action.
        assembly: Module from estimate and pusher to the state; None where the estimate is the state.
    """

    def __init__(self, spec: PolicySpec, features: int = 192) -> None:
        """Makes the layers.

        Args:
            spec: Specification of a policy that observes "rgb".
            features: Number of features of the images.
        """
        super().__init__()
        height, width, channels = spec.image_shape
        self.convolutions = nn.Sequential(
            nn.Conv2d(channels, 32, 4, 4),
            nn.ReLU(),
            nn.Conv2d(32, 64, 3, 2, 1),
            nn.ReLU(),
            nn.Conv2d(64, 64, 3, 1, 1),
            nn.ReLU(),
            nn.Flatten(),
        )
        with torch.no_grad():
            size = self.convolutions(torch.zeros(1, channels, height, width)).shape[1]
        self.features = nn.Sequential(nn.Linear(size, features), nn.ReLU())
        task = spec.task
        self.assembly = task.assembly(np.array(spec.pusher_low), np.array(spec.pusher_high))
        size_of_estimate = task.state_size if self.assembly is None else self.assembly.estimate_size
        self.estimate = nn.Sequential(
            nn.Linear(features + task.action_size, features), nn.ReLU(), nn.Linear(features, size_of_estimate)
        )
        self.actor = StateActor(task)
        self._components = task.action_size
        # As images come; convolutions take two thirds of the time with it.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # its stub lacks that

    @property
    def latent_size(self) -> int:
        """Width of the last hidden layer."""
        return self.actor.latent_size

    @property
    def head(self) -> nn.Module:
        """Layer from the last hidden layer to the logits, that of `actor`."""
        return self.actor.head

    @staticmethod
    def darken(image: Tensor) -> Tensor:
        """Images (B, channels, height, width) float32, 0 for white and 1 for black, of those that the policy sees.

        Args:
            image: (B, height, width, channels) RGB, uint8 or, as some of SB3's ways hand it on, floats from 0 to 255.
        """
        return 1.0 - image.permute(0, 3, 1, 2).float() / 255.0

    def state(self, dark: Tensor, pusher: Tensor) -> Tensor:
        """Estimate of the state (B, state_size), by images and the pusher's position.

        Args:
            dark: (B, channels, height, width) float32, as `darken` gives them.
            pusher: (B, n) float32, along the task's axes across the pusher's box, -1 to 1.
        """
        estimate: Tensor = self.estimate(torch.cat([self.features(self.convolutions(dark)), pusher], 1))
        if self.assembly is None:
            return estimate
        state: Tensor = self.assembly(estimate, pusher)
        return state

    def latent(self, seen: Seen) -> Tensor:
        """Last hidden layer (B, latent_size) of an observation with `image` and `pusher`."""
        assert isinstance(seen, Mapping)
        return self.actor.latent(self.state(self.darken(seen["image"]), seen["pusher"]))

    def logits(self, seen: Seen) -> Tensor:
        """Logits (B, n, len(LEVELS)) of an observation."""
        logits: Tensor = self.head(self.latent(seen)).unflatten(1, (self._components, -1))
        return logits

    def forward(self, image: Tensor, pusher: Tensor) -> Tensor:
        """Actions (B, n) in [-1, 1]^n of images and positions of the pusher.

        Args:
            image: (B, height, width, channels) uint8, RGB.
            pusher: (B, n) float32, along the task's axes across the pusher's box, -1 to 1.
        """
        return chosen(self.logits({"image": image, "pusher": pusher}))
