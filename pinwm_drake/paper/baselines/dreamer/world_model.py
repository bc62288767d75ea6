"""World model of images, the pusher's position, rewards and ends of episodes.

Source: Hafner et al., "Mastering Atari with discrete world models" (ICLR 2021), equations 1 to 5.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits

from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.paper.baselines.dreamer.networks import Decoder, Encoder, layers
from pinwm_drake.paper.baselines.dreamer.options import ModelOptions, NetworkOptions
from pinwm_drake.paper.baselines.dreamer.replay import Batch
from pinwm_drake.paper.baselines.dreamer.rssm import Latent, Rssm, balanced_divergence, divergence


class Perception(nn.Module):
    """Part of the world model that a policy needs: the encoder, and the latent dynamics."""

    def __init__(self, image_size: int, action_size: int, sizes: NetworkOptions) -> None:
        """Makes the layers.

        Args:
            image_size: px, side of the images, a power of two.
            action_size: Number n of components of an action and of the pusher's position.
            sizes: Sizes of the networks.

        Raises:
            ParameterError: The image size is not allowed.
        """
        super().__init__()
        self.encoder = Encoder(image_size, action_size, sizes.depth, sizes.units)
        self.rssm = Rssm(action_size, self.encoder.size, sizes)

    def embed(self, image: Tensor, pusher: Tensor) -> Tensor:
        """Features (..., size) of images (..., height, width, 3) uint8 RGB and pushers (..., n)."""
        lead = image.shape[:-3]
        return self.encoder(ImageActor.darken(image.flatten(0, -4)), pusher.flatten(0, -2)).unflatten(0, lead)


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms of the world model's loss, each () and weighted as in the sum.

    Attributes:
        image: Half the squared error of the images, summed over pixels.
        pusher: That of the pusher's position.
        reward: That of the reward.
        end: Cross-entropy of the end of episodes.
        divergence: Balanced divergence of posterior and prior.
        nats: The divergence itself [nat], without a gradient.
    """

    image: Tensor
    pusher: Tensor
    reward: Tensor
    end: Tensor
    divergence: Tensor
    nats: Tensor

    @property
    def total(self) -> Tensor:
        """The sum that is minimised."""
        return self.image + self.pusher + self.reward + self.end + self.divergence


class WorldModel(nn.Module):
    """Latent dynamics with an encoder, and heads for what is predicted.

    Attributes:
        perception: Encoder and latent dynamics.
        decoder: Head of images and the pusher's position.
        reward: Head of the reward, in standard deviations of the data's.
        goes_on: Head of the logit that an episode goes on after a step.
    """

    def __init__(self, image_size: int, action_size: int, sizes: NetworkOptions) -> None:
        super().__init__()
        features = sizes.feature_size
        self.perception = Perception(image_size, action_size, sizes)
        self.decoder = Decoder(features, image_size, action_size, sizes.depth, sizes.units)
        self.reward = layers(features, sizes.units, sizes.layers, 1)
        self.goes_on = layers(features, sizes.units, sizes.layers, 1)

    def posterior(self, batch: Batch, *, mode: bool = False) -> tuple[Latent, Tensor]:
        """Latent states (B, L, ...) of sequences, and the posterior's logits; see `Rssm.observe`."""
        embed = self.perception.embed(batch.image, batch.pusher)
        return self.perception.rssm.observe(batch.action, embed, batch.first, mode=mode)

    def loss(self, batch: Batch, options: ModelOptions) -> Terms:
        """Terms of the loss on sequences, means over their steps.

        The reward of a sequence's first step is left out, as the step before is not seen.
        """
        latent, posterior = self.posterior(batch)
        prior = self.perception.rssm.prior_logits(latent.deter)
        features = latent.features.flatten(0, 1)
        image, pusher = self.decoder(features)
        seen = ImageActor.darken(batch.image.flatten(0, 1))
        first, length = batch.first.flatten(), len(features)
        reward = (self.reward(features)[:, 0] - batch.reward.flatten()).masked_fill(first, 0.0)
        going = (~batch.terminal).flatten().to(features.dtype)
        balanced = balanced_divergence(posterior, prior, options.kl_balance, options.free_nats)
        return Terms(
            image=0.5 * (image - seen).square().sum() / length,
            pusher=0.5 * ((pusher - batch.pusher.flatten(0, 1)) / options.pusher_std).square().sum() / length,
            reward=0.5 * (reward / options.reward_std).square().sum() / length,
            end=binary_cross_entropy_with_logits(self.goes_on(features)[:, 0], going),
            divergence=options.kl_scale * balanced,
            nats=divergence(posterior.detach(), prior.detach()).mean(),
        )

    @torch.no_grad()
    def foresee(self, batch: Batch, seen: int, *, mode: bool = False) -> tuple[Tensor, Tensor]:
        """Images (B, L - seen, 3, height, width), 0 for white, and rewards (B, L - seen), of actions alone.

        Args:
            batch: Sequences; what is observed after the first steps is not looked at.
            seen: Number of steps at the beginning whose observations are seen, 1 to L - 1.
            mode: Flag: the likeliest latents instead of drawn ones.
        """
        known = Batch(*(part[:, :seen] for part in batch))
        latent = Latent(*(part[:, -1] for part in self.posterior(known, mode=mode)[0]))
        images, rewards = [], []
        for action in batch.action[:, seen:].unbind(1):
            latent = self.perception.rssm.imagine(latent, action, mode=mode)
            images.append(self.decoder(latent.features)[0])
            rewards.append(self.reward(latent.features)[:, 0])
        return torch.stack(images, 1), torch.stack(rewards, 1)
