# SPDX-License-Identifier: MIT
"""Networks of policies: from an observation to an action in [-1, 1]^n.

Two kinds of heads end a network. "levels" gives logits of a few levels for each component of an action, as PPO learns
them; the action is the mean of the likeliest level and its neighbours, weighted by their probabilities. A network that
imitated numbers would give the mean of two good ways around an object, which is none, and stand still there. "dither"
gives mean and spread for each component, as SAC learns them, and takes an action in between. "tanh" gives the mean
alone, as policies of SAC did before.

Sources: Tang and Agrawal, "Discretizing continuous action space for on-policy optimization" (AAAI 2020); Haarnoja et
al., "Soft actor-critic" (ICML 2018).
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, mse_loss

from pinwm_drake.errors import require
from pinwm_drake.learning.heading import Heading
from pinwm_drake.learning.images.window import Window
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.weights import device_of
from pinwm_drake.tasks.history import history_size
from pinwm_drake.tasks.registry import recipe_of
from pinwm_drake.tasks.task import Task

# rad for a unit of the state, and up to twice that: 10 mm of an object turn a wave by 3 to 6 rad. With 100, rounding in
# ONNX moved an action by 9 of the 10 micrometres that a bundle allows.
_WAVES = 30.0
_LOG_SPREADS = (-20.0, 2.0)  # as SB3's SAC has them
_FEATURES = 192  # of images
_LEAST = 4  # px, least side of what is seen of an image: that of the first layer's kernel
_COARSE = 56  # px, side of a single image's window up to which the first layer takes steps of 2 px; else 4
_FAR = 0.3  # m, unit of places that layers take
# An action between two levels, such as one of a plan that is imitated, is done by chance while PPO tries it: with
# thirds, 60 % of flips after imitation became 20 %; with ninths they became 90 %.
LEVELS = tuple(k / 9.0 for k in range(-9, 10))
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


def level_shares(action: Tensor) -> Tensor:
    """Shares (B, n, len(LEVELS)) of the levels next to each component of actions (B, n), whose mean it is."""
    levels = torch.tensor(LEVELS, device=action.device)
    spacing = LEVELS[1] - LEVELS[0]
    shares: Tensor = (1.0 - (action.unsqueeze(-1) - levels).abs() / spacing).clamp(min=0.0)
    return shares


class StateActor(nn.Module):
    """Network from the state (B, state_size) to an action: two hidden layers and a head.

    With a history the state goes on with what was before, as `tasks.history` has it: the layers see all of it.

    Attributes:
        outputs: Number of numbers of the head for each component of the action.
        activation: Activation of the hidden layers.
        latent_size: Width of the last hidden layer.
        head: Linear layer to the numbers of each component of the action, those of the first component first.
        heading: Frame that the layers see and act in, where the task has one.
    """

    outputs: ClassVar[int]
    activation: ClassVar[type[nn.Module]] = nn.ReLU

    def __init__(self, task: Task, width: int = 256, history: int = 0) -> None:
        """Build layers of a width for a task's state and action, with those before the last actions."""
        super().__init__()
        self.latent_size, self._components = width, task.action_size
        self.heading = Heading(task)
        size, activation = history_size(task.state_size, task.action_size, history), self.activation
        self.body = nn.Sequential(nn.Linear(size, width), activation(), nn.Linear(width, width), activation())
        self.head = nn.Linear(width, task.action_size * self.outputs)

    def latent(self, seen: Seen) -> Tensor:
        """Last hidden layer (B, latent_size) of an observation: the state, or a dict with `state`."""
        state = seen["state"] if isinstance(seen, Mapping) else seen
        latent: Tensor = self.body(self.heading.state(state))
        return latent

    def mean(self, state: Tensor) -> Tensor:
        """Actions (B, n) of states (B, state_size), or their means where a wave is added."""
        raise NotImplementedError

    def imitation(self, found: Tensor, state: Tensor) -> Tensor:
        """Loss () of acting by estimated states instead of the true ones: mean squared difference of the actions.

        Args:
            found: (B, state_size) estimates, to which the gradient goes.
            state: (B, state_size) true states.
        """
        with torch.no_grad():
            wanted = self.mean(state)
        return mse_loss(self.mean(found), wanted)

    def margin(self, state: Tensor) -> Tensor:
        """Lead (B,) of the choice that the actions follow over the next one, the least among an action's components.

        It is infinite where the actions follow no choice.
        """
        return state.new_full((len(state),), torch.inf)


class LevelActor(StateActor):
    """Network from the state to an action by levels; hidden layers of tanh."""

    outputs, activation = len(LEVELS), nn.Tanh

    def logits(self, seen: Seen) -> Tensor:
        """Logits (B, n, len(LEVELS)) of an observation."""
        logits: Tensor = self.head(self.latent(seen)).unflatten(1, (self._components, -1))
        return logits

    def forward(self, state: Tensor) -> Tensor:
        """Actions (B, n) of states (B, state_size) float32."""
        return self.heading.action(chosen(self.logits(state)), state)

    def imitation(self, found: Tensor, state: Tensor) -> Tensor:
        """Cross-entropy of the levels; see `StateActor.imitation`."""
        with torch.no_grad():
            shares = self.logits(state).softmax(-1)
        return cross_entropy(self.logits(found).flatten(0, 1), shares.flatten(0, 1))

    def margin(self, state: Tensor) -> Tensor:
        """Lead (B,) of the likeliest level in logits; see `StateActor.margin`."""
        best = self.logits(state).topk(2, dim=-1).values
        return (best[..., 0] - best[..., 1]).amin(-1)


class DitherActor(StateActor):
    """Network from the state to SAC's distribution of actions, of which it takes one; hidden layers of ReLU.

    SAC's distribution covers both of two good ways around an object, and its mean, which lies between them, stands
    still: a policy that acts by it may do so for ever. This one takes the mean plus sqrt(2) spread sin(F s), a wave of
    the state s that is as far from the mean, on average, as a draw would be: an action follows from the state, and
    where the spread is wide a state hardly stays as it is.
    """

    outputs = 2
    _waves: Tensor

    def __init__(self, task: Task, width: int = 256, history: int = 0) -> None:
        super().__init__(task, width, history)
        number = task.state_size * task.action_size
        waves = _WAVES * torch.linspace(1.0, 2.0, number).reshape(task.state_size, task.action_size)
        self.register_buffer("_waves", waves, persistent=False)

    def _parts(self, state: Tensor) -> tuple[Tensor, Tensor]:
        """Means and logarithms of the spreads (B, n) each, before tanh, of states (B, state_size)."""
        mean, log_spread = self.head(self.latent(state)).unflatten(1, (self._components, 2)).unbind(2)
        return mean, log_spread.clamp(*_LOG_SPREADS)

    def forward(self, state: Tensor) -> Tensor:
        """Actions (B, n) of states (B, state_size) float32."""
        mean, log_spread = self._parts(state)
        now = self.heading.state(state)[:, : len(self._waves)]
        wave = math.sqrt(2.0) * torch.sin(now @ self._waves)
        return self.heading.action((mean + log_spread.exp() * wave).tanh(), state)

    def mean(self, state: Tensor) -> Tensor:
        """Means (B, n) of the actions of states (B, state_size)."""
        return self.heading.action(self._parts(state)[0].tanh(), state)


class TanhActor(StateActor):
    """Network from the state to an action by numbers; hidden layers of ReLU, as SB3's SAC has them."""

    outputs = 1

    def forward(self, state: Tensor) -> Tensor:
        """Actions (B, n) of states (B, state_size) float32."""
        return self.heading.action(self.head(self.latent(state)).tanh(), state)

    mean = forward


_HEADS: Mapping[str, Callable[[Task, int, int], StateActor]] = {
    "levels": LevelActor,
    "tanh": TanhActor,
    "dither": DitherActor,
}


def state_actor(spec: PolicySpec) -> StateActor:
    """Return an untrained network from the state to the action, with the head that a specification names."""
    return _HEADS[spec.head](spec.task, spec.width, spec.history)


class ImageActor(nn.Module):
    """Network from images and the pusher's position to an action, by way of an estimate of the state.

    Between the two stands a state as `StateActor` takes it, so that what was learned from the state can be taken over.
    The task says what of it has to be estimated (`Task.assembly`). Where the specification has a window, the layers see
    that part of the images, and the estimate of the place is added to the place that the window shows.

    Without a history, the layers see the stack of images at once. With one, they see each image by itself, in a window
    of its own: the same layers tell the features of all images, and the state at the time of each from its features and
    those of the image before. The actions themselves are known.

    Attributes:
        actor: Network from the state to the action.
        task: The task.
        history: Number of the last actions that it sees; see `PolicySpec`.
        window: Module that cuts the window out; None where the layers see all of an image.
        assembly: Module from estimate and pusher to the state; None where the estimate is the state.
        mixed_precision: Flag: the layers from images to features multiply numbers of 16 bits (bfloat16), as a training
            asks for where the CPU is quicker so; weights keep 32 bits.
    """

    def __init__(self, spec: PolicySpec) -> None:
        """Make the layers for a specification of a policy that observes "rgb".

        Raises:
            ParameterError: What the network sees of an image is too small for its first layer.
        """
        super().__init__()
        height, width, channels = spec.image_shape
        self._frames = spec.frames if spec.history else 1  # that are seen one by one
        channels //= self._frames
        self.window = None if spec.window is None else Window(spec)
        if spec.window is not None:
            height = width = spec.window
        # What is left after the strides tells where things are.
        first = nn.Conv2d(channels, 32, 4, 4)
        if spec.window is not None:
            fine = bool(spec.history) and spec.window > _COARSE
            first = nn.Conv2d(channels, 32, 6, 4, 1) if fine else nn.Conv2d(channels, 32, 3, 2, 1)
        self.convolutions = nn.Sequential(
            first,
            nn.ReLU(),
            nn.Conv2d(32, 64, 3, 2, 1),
            nn.ReLU(),
            nn.Conv2d(64, 64, 3, 1, 1),
            nn.ReLU(),
            nn.Flatten(),
        )
        large = min(width, height) >= _LEAST
        require("camera or window", f"{width} x {height} px", large, f"{_LEAST} px a side or more")
        with torch.no_grad():
            size = self.convolutions(torch.zeros(1, channels, height, width)).shape[1]
        self.features = nn.Sequential(nn.Linear(size, _FEATURES), nn.ReLU())
        self.mixed_precision = False
        self.task = task = spec.task
        self.history = spec.history
        self.assembly = recipe_of(task).assembly(task, np.array(spec.pusher_low), np.array(spec.pusher_high))
        size_of_estimate = task.state_size if self.assembly is None else self.assembly.estimate_size
        seen = 2 if spec.history else 1  # images, or stacks of them, that an estimate is made of
        known = task.action_size + (0 if spec.window is None else 2 * seen)
        self.estimate = nn.Sequential(
            nn.Linear(seen * _FEATURES + known, _FEATURES), nn.ReLU(), nn.Linear(_FEATURES, size_of_estimate)
        )
        self.actor = state_actor(spec)
        # As images come; convolutions take two thirds of the time with it.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # its stub lacks that

    def estimation(self) -> Iterator[nn.Parameter]:
        """Parameters of the layers from images to the estimate."""
        for layers in (self.convolutions, self.features, self.estimate):
            yield from layers.parameters()

    @property
    def latent_size(self) -> int:
        """Width of the last hidden layer."""
        return self.actor.latent_size

    @property
    def heading(self) -> Heading:
        """Frame that the layers of `actor` see and act in."""
        return self.actor.heading

    @property
    def head(self) -> nn.Module:
        """Layer from the last hidden layer to the actions, that of `actor`."""
        return self.actor.head

    @staticmethod
    def darken(image: Tensor) -> Tensor:
        """Images (B, channels, height, width) float32, 0 for white and 1 for black, of those that the policy sees.

        Args:
            image: (B, height, width, channels) RGB, uint8 or, as some of SB3's ways hand it on, floats from 0 to 255.
        """
        dark: Tensor = image.permute(0, 3, 1, 2).to(torch.float32, copy=True).sub_(255.0).div_(-255.0)
        return dark

    @property
    def sees_parts(self) -> bool:
        """Flag: an image has a window of its own, so that `parts` are enough."""
        return self._frames > 1 and self.window is not None

    def parts(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Parts (B, h, w, 3) of single images that are enough to learn from, and their corners (B, 2) px; see `Window`.

        Args:
            image: (B, height, width, 3) uint8, RGB.
        """
        if not self.sees_parts:
            return image, np.zeros((len(image), 2), int)
        assert self.window is not None
        found, corner = self.window.part(torch.from_numpy(np.ascontiguousarray(image)).to(device_of(self)))
        return found.cpu().numpy(), corner.cpu().numpy()

    def state(
        self,
        image: Tensor,
        pusher: Tensor,
        goal: Tensor | None = None,
        corner: Tensor | None = None,
        tint: Tensor | None = None,
    ) -> Tensor:
        """Estimate of the state (B, state_size), by images and the pusher's position; both may have a history.

        Args:
            image: (B, height, width, channels) RGB, as for `darken`; or parts of these, of which `corner` tells.
            pusher: (B, n) float32, along the task's axes across the pusher's box, -1 to 1; then what was before.
            goal: (B, task.goal_size) float32, goals of the episodes; None for the task's own.
            corner: (B, frames, 2) px, first pixels of the images, where they are parts of the camera's; see `parts`.
            tint: (B, 3) factors of the darkness of red, green and blue in all parts of a stack, which are not changed
                otherwise; None where they are changed already.
        """
        if self._frames > 1:
            image = torch.cat(image.chunk(self._frames, 3))
            corner = None if corner is None else torch.cat(corner.unbind(1))
            tint = None if tint is None else tint.repeat(self._frames, 1)
        place = None
        if self.window is None:
            assert tint is None, "a tint is of parts"
            dark = self.darken(image)
        else:
            dark, place = self.window(image, corner, tint)
        with torch.autocast("cpu", torch.bfloat16) if self.mixed_precision else nullcontext():
            features = self.features(self.convolutions(dark)).float()
        if not self.history:
            return self._estimated(features, pusher, place, goal)
        # (frames B, ...), the oldest first.
        images = features.chunk(self._frames)
        places = None if place is None else place.chunk(self._frames)
        n, parts = self.task.action_size, []
        for back in range(1 + self.history):
            at = self._frames - 1 - back
            before = max(at - 1, 0)
            there, last = (None, None) if places is None else (places[at], places[before] - places[at])
            begin = max(2 * back - 1, 0) * n  # of the pusher at that time, which an action follows, but for now
            both = torch.cat([images[at], images[before]], 1)
            parts.append(self._estimated(both, pusher[:, begin : begin + n], there, goal, last))
            if back:
                parts.append(pusher[:, begin + n : begin + 2 * n])
        return torch.cat(parts, 1)

    def _estimated(
        self, features: Tensor, pusher: Tensor, place: Tensor | None, goal: Tensor | None, last: Tensor | None = None
    ) -> Tensor:
        """State (B, state_size) of features, with the pusher (B, n) and the window's place, and that before from it."""
        known = [pusher, *(one / _FAR for one in (place, last) if one is not None)]
        return self._assembled(self.estimate(torch.cat([features, *known], 1)), pusher, place, goal)

    def _assembled(self, estimate: Tensor, pusher: Tensor, place: Tensor | None, goal: Tensor | None) -> Tensor:
        """State (B, state_size) of an estimate, with the pusher (B, n) at that time; the others as for `state`."""
        if self.assembly is None:
            return estimate
        state: Tensor = self.assembly(estimate, pusher, place, *([] if goal is None else [goal]))
        return state

    def latent(self, seen: Seen) -> Tensor:
        """Last hidden layer (B, latent_size) of an observation with `image` and `pusher`."""
        assert isinstance(seen, Mapping)
        return self.actor.latent(self.state(seen["image"], seen["pusher"], seen.get("goal")))

    def forward(self, image: Tensor, pusher: Tensor, goal: Tensor | None = None) -> Tensor:
        """Actions (B, n) in [-1, 1]^n of images and positions of the pusher.

        Args:
            image: (B, height, width, channels) uint8, RGB.
            pusher: (B, n) float32, along the task's axes across the pusher's box, -1 to 1; then what was before.
            goal: (B, task.goal_size) float32, goals of the episodes; None for the task's own.
        """
        actions: Tensor = self.actor(self.state(image, pusher, goal))
        return actions if goal is None else self.task.world_action(actions, goal)
