"""Networks of policies: from what is seen to an action in [-1, 1]^2.

Each component of an action is one of a few levels. The likeliest is taken, and what it and its neighbours are likely by
settles where between them the action is. A network that gave numbers would give the mean of two good ways around an
object, which is none, and stand still there.

Source: Tang and Agrawal, "Discretizing continuous action space for on-policy optimization" (AAAI 2020).
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn

from pinwm_drake.learning.spec import LENGTH, PolicySpec

STATE_SIZE, ACTION_SIZE = 11, 2
_MOTION_SIZE = 7  # of the state, without the pusher
LEVELS = tuple(k / 3.0 for k in range(-3, 4))
Seen = Tensor | Mapping[str, Tensor]


def chosen(logits: Tensor) -> Tensor:
    """Actions (B, 2) of logits (B, 2, len(LEVELS)): the mean of the likeliest level and its neighbours.

    Not a number where logits are none.
    """
    levels = torch.tensor(LEVELS, device=logits.device)
    numbers = torch.arange(len(LEVELS), device=logits.device)
    far = (numbers - logits.argmax(-1, keepdim=True)).abs() > 1
    actions: Tensor = logits.masked_fill(far, -torch.inf).softmax(-1) @ levels
    return actions


class StateActor(nn.Module):
    """An action from the state (B, 11): two hidden layers of tanh.

    Attributes:
        latent_size: Width of the last hidden layer.
        head: From there to the logits of the action's levels, those of the first component first.
    """

    def __init__(self, width: int = 256) -> None:
        """Makes layers of a width."""
        super().__init__()
        self.latent_size = width
        self.body = nn.Sequential(nn.Linear(STATE_SIZE, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh())
        self.head = nn.Linear(width, ACTION_SIZE * len(LEVELS))

    def latent(self, seen: Seen) -> Tensor:
        """(B, latent_size) of an observation: the state, or a dict with `state`."""
        state = seen["state"] if isinstance(seen, Mapping) else seen
        latent: Tensor = self.body(state)
        return latent

    def logits(self, seen: Seen) -> Tensor:
        """(B, 2, len(LEVELS)) of an observation."""
        logits: Tensor = self.head(self.latent(seen)).unflatten(1, (ACTION_SIZE, -1))
        return logits

    def forward(self, state: Tensor) -> Tensor:
        """Actions (B, 2) of states (B, 11) float32."""
        return chosen(self.logits(state))


class ImageActor(nn.Module):
    """An action from images and the pusher's position: where the object is and how it moves, and what to do then.

    Between the two stands a state as `StateActor` takes it, so that what was learned from the state can be taken over.
    The convolutions have strides of 4, 2 and 1, so that what is left tells where things are.

    Attributes:
        actor: From the state to the action.
    """

    placing: Tensor
    origin: Tensor

    def __init__(self, spec: PolicySpec, features: int = 192) -> None:
        """Makes the layers.

        Args:
            spec: Of a policy that observes "rgb".
            features: Of the images, how many.
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
        self.estimate = nn.Sequential(nn.Linear(features + 2, features), nn.ReLU(), nn.Linear(features, _MOTION_SIZE))
        self.actor = StateActor()
        # From the pusher's position across its box to that from the goal, in units of the state.
        low, high = torch.tensor(spec.pusher_low), torch.tensor(spec.pusher_high)
        c, s = math.cos(spec.goal[2]), math.sin(spec.goal[2])
        R_GW = torch.tensor([[c, s], [-s, c]]) / LENGTH
        self.register_buffer("placing", 0.5 * R_GW * (high - low), persistent=False)
        self.register_buffer("origin", R_GW @ (0.5 * (low + high) - torch.tensor(spec.goal[:2])), persistent=False)
        # As images come; convolutions take two thirds of the time with it.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # its stub lacks that

    @property
    def latent_size(self) -> int:
        """Width of the last hidden layer."""
        return self.actor.latent_size

    @property
    def head(self) -> nn.Module:
        """From there to the logits."""
        return self.actor.head

    @staticmethod
    def darken(image: Tensor) -> Tensor:
        """(B, channels, height, width) float32, 0 for white, of images as the policy sees them.

        Args:
            image: (B, height, width, channels), uint8 or, as some of SB3's ways hand it on, floats of the same range.
        """
        return 1.0 - image.permute(0, 3, 1, 2).float() / 255.0

    def state(self, dark: Tensor, pusher: Tensor) -> Tensor:
        """The state (B, 11), as far as images tell.

        Args:
            dark: (B, channels, height, width), as `darken` has it.
            pusher: (B, 2), across its box.
        """
        motion = self.estimate(torch.cat([self.features(self.convolutions(dark)), pusher], 1))
        heading = nn.functional.normalize(motion[:, 2:4])
        c, s = heading.unbind(1)
        p = pusher @ self.placing.T + self.origin
        x, y = (p - motion[:, :2]).unbind(1)
        seen_from_object = torch.stack([c * x + s * y, c * y - s * x], 1)
        return torch.cat([motion[:, :2], heading, motion[:, 4:], seen_from_object, p], 1)

    def latent(self, seen: Seen) -> Tensor:
        """(B, latent_size) of an observation with `image` and `pusher`."""
        assert isinstance(seen, Mapping)
        return self.actor.latent(self.state(self.darken(seen["image"]), seen["pusher"]))

    def logits(self, seen: Seen) -> Tensor:
        """(B, 2, len(LEVELS)) of an observation."""
        logits: Tensor = self.head(self.latent(seen)).unflatten(1, (ACTION_SIZE, -1))
        return logits

    def forward(self, image: Tensor, pusher: Tensor) -> Tensor:
        """Actions (B, 2).

        Args:
            image: (B, height, width, channels) uint8.
            pusher: (B, 2) float32, x and y across the pusher's box, -1 to 1.
        """
        return chosen(self.logits({"image": image, "pusher": pusher}))
