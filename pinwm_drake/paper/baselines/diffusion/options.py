# SPDX-License-Identifier: MIT
"""Settings of diffusion policy, smaller than the official ones, so that two cores can train it."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from pinwm_drake.errors import require
from pinwm_drake.learning.options import Options
from pinwm_drake.validation import check_fields

NORM_CHANNELS = 8  # of a group of the encoder's group normalisation; official 16
_Count = Annotated[int, Field(ge=1, json_schema_extra={"allowed": "a whole number, 1 or more"})]
_Counts = Annotated[tuple[_Count, ...], Field(min_length=1, json_schema_extra={"allowed": "whole numbers, 1 or more"})]


@dataclass(frozen=True)
class NetworkOptions:
    """Settings of the network, and of how it draws actions.

    "Official" is the configuration `train_diffusion_unet_hybrid_workspace` of the authors' repository, for push-T from
    images.

    Attributes:
        horizon: Number of actions that are drawn at once, Th; the first is that of the oldest observation.
        observations: Number of the last observations that are seen, To.
        actions: Number of actions that are carried out before the next ones are drawn, Ta.
        diffusion_steps: Number of steps in which training turns actions into noise.
        sampling_steps: Number of steps of DDIM that turn noise into actions; official 100 of DDPM, 16 of DDIM in the
            paper's real tasks.
        widths: Channels of the U-Net's levels; official 512, 1024, 2048.
        kernel: Width of its convolutions, odd.
        groups: Number of groups of its group normalisation; divides the widths.
        step_features: Number of features of the diffusion's step, even.
        channels: Channels of the encoder's stages, each of which halves the image; official a ResNet-18.
        keypoints: Number of points that spatial softmax finds.

    Raises:
        ParameterError: A number is out of range.
    """

    horizon: _Count = 16
    observations: _Count = 2
    actions: _Count = 8
    diffusion_steps: _Count = 100
    sampling_steps: _Count = 16
    widths: _Counts = (64, 128, 256)
    kernel: _Count = 5
    groups: _Count = 8
    step_features: _Count = 128
    channels: _Counts = (16, 32, 64)
    keypoints: _Count = 32
    image_features: _Count = 64

    def __post_init__(self) -> None:
        check_fields(self)
        halved = 2 ** (len(self.widths) - 1)
        require("horizon", self.horizon, self.horizon % halved == 0, f"a multiple of {halved}, as there are levels")
        most = self.horizon - self.observations + 1
        require("actions", self.actions, self.actions <= most, f"1 to {most}, what is drawn from the present on")
        fewer = self.sampling_steps <= self.diffusion_steps
        require("sampling_steps", self.sampling_steps, fewer, "1 to diffusion_steps")
        require("kernel", self.kernel, self.kernel % 2 == 1, "an odd number")
        require("step_features", self.step_features, self.step_features % 2 == 0, "an even number")
        divided = all(width % self.groups == 0 for width in self.widths)
        require("groups", self.groups, divided, f"a divisor of the widths {self.widths}")
        grouped = all(width % max(1, width // NORM_CHANNELS) == 0 for width in self.channels)
        require("channels", self.channels, grouped, f"below {NORM_CHANNELS}, or multiples of it")


@dataclass(frozen=True)
class TrainingOptions(Options):
    """Settings of the training.

    Attributes:
        updates: Number of updates of the network; rounded up to whole rounds. Official 3,050 epochs of all windows.
        round_updates: Number of updates in a round; an evaluation follows.
        learning_rate: Highest learning rate of AdamW; it rises evenly in the warm-up, and falls to 0 along half a
            cosine. Official 1e-4, for a network a hundred times as large and many more updates.
        warmup: Number of updates in which the learning rate rises.
        average_power: Power p of the weights' moving average, whose decay is 1 - (1 + update)^-p.
        average_most: Largest decay of the moving average.
        shift: px, largest random shift of the images; official a random crop that moves them by up to a tenth. The goal
            is not in the images here: a pixel of a shift is 8 mm of it.
        gain: Relative half-width of the colours' random factors; official 0.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ("warmup", "weight_decay", "shift", "gain")

    updates: int = 20_000
    round_updates: int = 2_000
    batch_size: int = 64
    learning_rate: float = 3e-4
    warmup: int = 500
    weight_decay: float = 1e-6
    average_power: float = 0.75
    average_most: float = 0.9999
    shift: int = 0
    gain: float = 0.0
    episodes: int = 64

    def __post_init__(self) -> None:
        super().__post_init__()
        require("average_most", self.average_most, self.average_most < 1.0, "less than 1")
