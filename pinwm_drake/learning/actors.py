"""Networks of policies: from what is seen to an action in [-1, 1]^2.

Each component of an action is one of a few levels. The likeliest is taken, and what it and its neighbours are likely by
settles where between them the action is. A network that gave numbers would give the mean of two good ways around an
object, which is none, and stand still there.

Source: Tang and Agrawal, "Discretizing continuous action space for on-policy optimization" (AAAI 2020).
"""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn

STATE_SIZE, ACTION_SIZE, POSE_SIZE = 11, 2, 4
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


class ImageEncoder(nn.Module):
    """Features of a stack of images; strides of 4, 2 and 1, so that what is left tells where things are."""

    def __init__(self, height: int, width: int, channels: int, features: int = 192) -> None:
        """Makes the layers.

        Args:
            height: px.
            width: px.
            channels: 3 for each image.
            features: How many come out.
        """
        super().__init__()
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

    def forward(self, dark: Tensor) -> Tensor:
        """(B, features) of images (B, channels, height, width), 0 for white and 1 for black."""
        features: Tensor = self.features(self.convolutions(dark))
        return features


class ImageActor(nn.Module):
    """An action from images and the pusher's position.

    Attributes:
        latent_size: Width of the last hidden layer.
        head: From there to the logits of the action's levels, those of the first component first.
        pose: From the images' features to x, y [0.1 m], cos and sin of the yaw from the goal: asked for in training, so
            that the features tell where the object is.
        augment: Changes images (B, channels, height, width), 0 for white, at random while `training`; None for nothing.
    """

    def __init__(self, height: int, width: int, channels: int, features: int = 192) -> None:
        """Makes the layers; see `ImageEncoder`."""
        super().__init__()
        self.latent_size = features
        self.augment: Callable[[Tensor], Tensor] | None = None
        self.encoder = ImageEncoder(height, width, channels, features)
        self.body = nn.Sequential(
            nn.Linear(features + 2, features), nn.ReLU(), nn.Linear(features, features), nn.ReLU()
        )
        self.head = nn.Linear(features, ACTION_SIZE * len(LEVELS))
        self.pose = nn.Linear(features, POSE_SIZE)
        # As images come; convolutions take two thirds of the time with it.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # its stub lacks that

    @staticmethod
    def darken(image: Tensor) -> Tensor:
        """(B, channels, height, width) float32, 0 for white: what the encoder takes, of images as the policy sees them.

        Args:
            image: (B, height, width, channels), uint8 or floats of the same range.
        """
        return 1.0 - image.permute(0, 3, 1, 2).float() / 255.0

    def latent(self, seen: Seen) -> Tensor:
        """(B, latent_size) of an observation with `image` and `pusher`."""
        assert isinstance(seen, Mapping)
        dark = self.darken(seen["image"])
        if self.training and self.augment is not None:
            dark = self.augment(dark)
        latent: Tensor = self.body(torch.cat([self.encoder(dark), seen["pusher"]], 1))
        return latent

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

    def with_pose(self, dark: Tensor, pusher: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (B, 2, len(LEVELS)) and poses (B, 4), for training.

        Args:
            dark: (B, channels, height, width), as `darken` has it.
            pusher: (B, 2).
        """
        features = self.encoder(dark)
        logits: Tensor = self.head(self.body(torch.cat([features, pusher], 1))).unflatten(1, (ACTION_SIZE, -1))
        return logits, self.pose(features)
