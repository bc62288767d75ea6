# SPDX-License-Identifier: MIT
"""Settings of Dreamer V2, with the values of the paper's own code where they are others here.

"Official" are the defaults of `danijar/dreamerv2` (configs.yaml), with those for images of the DeepMind Control Suite.
Networks are smaller here, as two cores learn them.
"""

from dataclasses import dataclass
from typing import ClassVar

from pinwm_drake.errors import require
from pinwm_drake.learning.options import Options


@dataclass(frozen=True)
class NetworkOptions(Options):
    """Sizes of the world model's networks, which a policy on disk has to name.

    Attributes:
        deter: Size of the recurrent state; official: 1024, or 200 for control.
        hidden: Width of the layers around the recurrent cell; official: as `deter`.
        latents: Number of categorical latents; official: 32.
        classes: Number of classes of each latent; official: 32.
        depth: Number of channels of the first convolution, which double with each further one; official: 48.
        units: Width of the heads' hidden layers, of actor and critic too; official: 400.
        layers: Number of hidden layers of each; official: 4.
    """

    deter: int = 200
    hidden: int = 200
    latents: int = 16
    classes: int = 16
    depth: int = 8
    units: int = 200
    layers: int = 2

    @property
    def feature_size(self) -> int:
        """Number of features of a latent state: those drawn, and the recurrent state."""
        return self.latents * self.classes + self.deter


@dataclass(frozen=True)
class ModelOptions(Options):
    """Settings of the world model's training.

    Attributes:
        length: Number of steps of a sequence; official: 50.
        kl_balance: Share of the gradient of the divergence that moves the prior, the rest the posterior, 0 to 1.
        kl_scale: Weight of the divergence; official: 0.1 for Atari, 1 for control. With 1 a square of 2 x 2 px was not
            learned: its error weighs less than what the latents would have to tell.
        free_nats: Divergence [nat] below which it is not reduced any further.
        pusher_std: Standard deviation of the pusher's position as it is decoded, in halves of its box; official, for
            any numbers: 1. The images do not show the pusher, and one unit is the whole of its box.
        reward_std: Standard deviation of the reward as it is decoded, in units of that of the data; official: 1.
        weight_decay: Share of the weights that each update takes off, times the learning rate.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ("kl_balance", "free_nats", "weight_decay")
    up_to_one: ClassVar[tuple[str, ...]] = ("kl_balance",)

    updates: int = 6000
    batch_size: int = 16
    length: int = 32
    learning_rate: float = 3e-4
    kl_balance: float = 0.8
    kl_scale: float = 0.1
    free_nats: float = 1.0
    pusher_std: float = 0.05
    reward_std: float = 0.3
    weight_decay: float = 1e-6
    clip: float = 100.0


@dataclass(frozen=True)
class BehaviourOptions(Options):
    """Settings of actor and critic, which learn in imagination.

    Attributes:
        batch_size: Number of sequences whose states an update imagines from.
        length: Number of steps of such a sequence; official: 50.
        trace: Weight λ of longer returns, 0 to 1.
        entropy: Weight of the actor's entropy; official: 1e-4 for control.
        actor_rate: Learning rate of the actor; official: 8e-5.
        critic_rate: Learning rate of the critic; official: 8e-5.
        target_period: Number of updates after which the slow critic becomes a copy of the critic.
        weight_decay: Share of the weights that each update takes off, times the learning rate.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ("trace", "entropy", "weight_decay")
    up_to_one: ClassVar[tuple[str, ...]] = ("discount", "trace")

    rounds: int = 8
    round_updates: int = 500
    episodes: int = 64
    batch_size: int = 16
    length: int = 16
    horizon: int = 15
    discount: float = 0.99
    trace: float = 0.95
    entropy: float = 1e-4
    actor_rate: float = 3e-4
    critic_rate: float = 3e-4
    target_period: int = 100
    weight_decay: float = 1e-6
    clip: float = 100.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require("horizon", self.horizon, self.horizon >= 2, "2 or more, as the first step's action is not learned")
