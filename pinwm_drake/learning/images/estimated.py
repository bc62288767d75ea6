# SPDX-License-Identifier: MIT
"""Worlds in which a policy acts on what a network sees in their images: an estimate of the state.

The estimate is learned by regression on the true state, which the worlds know; rewards do not reach it. A policy of the
state can so be trained as fast as without images, on the estimates that it will have.

Sources: a critic that sees the true state: Pinto et al., "Asymmetric actor critic for image-based robot learning" (RSS
2018); auxiliary targets: Jaderberg et al., "Reinforcement learning with unsupervised auxiliary tasks" (ICLR 2017); an
encoder without the actor's gradients: Yarats et al., "Improving sample efficiency in model-free reinforcement learning
from images" (AAAI 2021).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor
from torch.nn.functional import huber_loss

from pinwm_drake.errors import require
from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.learning.images.augment import Augment
from pinwm_drake.learning.weights import device_of
from pinwm_drake.learning.worlds import SeenWorlds
from pinwm_drake.tasks.history import begun
from pinwm_drake.tasks.task import Task

FAR = 0.3  # of the state's units, from which on an error counts by its size, and not by its square
_FAR_ERRORS = 3.0  # the same, in usual errors of the components
_SHOWN = 0.05  # share of an image's pixels, from which on an object in it can be seen well
TRUTH = "truth"  # the true state, beside its estimate "state"


def estimation_loss(found: Tensor, state: Tensor, errors: Tensor | None = None, shown: Tensor | None = None) -> Tensor:
    """Loss () of estimates of states (B, n): Huber's, as what cannot be seen is not to outweigh the rest.

    Args:
        found: (B, n) estimates.
        state: (B, n) true states.
        errors: (n,) usual errors of the components, in whose units they count; see `usual_errors`. None where all count
            alike.
        shown: (B, n) weights; see `shown_components`. None for one.
    """
    if errors is None:
        each = huber_loss(found, state, delta=FAR, reduction="none")
    else:
        off = (found - state) / errors
        each = huber_loss(off, torch.zeros_like(off), delta=_FAR_ERRORS, reduction="none")
    return 2.0 * (each if shown is None else each * shown).mean()


def usual_errors(task: Task, history: int, device: torch.device) -> Tensor | None:
    """Usual errors of a state's components, with those before the last actions; infinite for the actions.

    Returns:
        (n,) float32; None where a task tells no errors.

    Raises:
        ParameterError: The task's errors are not as many as its state has components, or one is not more than 0.
    """
    if not task.errors:
        return None
    known = len(task.errors) == task.state_size and all(error > 0.0 for error in task.errors)
    require("task.errors", task.errors, known, f"{task.state_size} numbers, more than 0")
    errors = begun(np.array(task.errors)[None], task.action_size, history)[0]
    return torch.from_numpy(np.where(errors > 0.0, errors, np.inf).astype(np.float32)).to(device)


def shown_components(image: Tensor, task: Task, history: int) -> Tensor:
    """Weights of a state's components, with those before the last actions: 0 where the image of its time shows nothing.

    Where an object has left the view its place cannot be learned, and its error of decimetres would outweigh the rest.

    Args:
        image: (B, height, width, 3 k) uint8, RGB on white: stacks of k images or of parts of them, the oldest first;
            k is more than `history`.
        task: The task.
        history: Number of the last actions.

    Returns:
        (B, n) float32, 0 or 1.
    """
    there = (image.unflatten(3, (-1, 3)) < 255).any(-1).float().mean((1, 2)) >= _SHOWN
    columns = [there[:, -1:].expand(-1, task.state_size)]
    for back in range(1, 1 + history):
        columns.append(there[:, -1 - back, None].expand(-1, task.state_size + task.action_size))
    return torch.cat(columns, 1).float()


class Estimated(SeenWorlds):
    """Worlds whose observation is a dict of `state`, as a network estimates it, and of the true one, `truth`.

    The last observations are kept to learn from: as many as a rollout has.
    """

    def __init__(self, env: VecEnv, actor: ImageActor, length: int) -> None:
        """Wrap worlds whose observation is a dict with `image`, `pusher` and `state`; `goal` where episodes draw it.

        Args:
            env: The worlds.
            actor: The network; it is asked for each observation, and trained elsewhere.
            length: Number of observations of each world that are kept, 1 or more.
        """
        space: Any = env.observation_space
        super().__init__(env, spaces.Dict({"state": space["state"], TRUTH: space["state"]}))
        self._actor, self._next = actor, 0
        shape = (length, env.num_envs)
        self._kept = {name: np.zeros((*shape, *space[name].shape), space[name].dtype) for name in space.spaces}

    def kept(self) -> dict[str, Tensor]:
        """Observations (N, ...) of the worlds, oldest first: `image`, `pusher`, `state` and, where there is, `goal`."""
        kept = {name: np.roll(values, -self._next, axis=0) for name, values in self._kept.items()}
        return {name: torch.from_numpy(values).flatten(0, 1) for name, values in kept.items()}

    def seen(self, observation: Any) -> dict[str, np.ndarray]:
        """Estimates and states of an observation, which is kept."""
        for name, values in observation.items():
            self._kept[name][self._next] = values
        self._next = (self._next + 1) % len(self._kept["state"])
        return self._estimated(observation)

    def last(self, observation: Any) -> dict[str, np.ndarray]:
        """Estimate and state of the last observation of an episode."""
        found = self._estimated({name: values[None] for name, values in observation.items()})
        return {name: values[0] for name, values in found.items()}

    def _estimated(self, seen: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        device = device_of(self._actor)
        given = {name: torch.from_numpy(values).to(device) for name, values in seen.items()}
        with torch.inference_mode():
            found = self._actor.state(given["image"], given["pusher"], given.get("goal"))
        return {"state": found.cpu().numpy(), TRUTH: seen["state"]}


class Regression(BaseCallback):
    """Callback that trains the network of `Estimated` worlds, after every rollout, on what was seen in it."""

    def __init__(
        self,
        worlds: Estimated,
        actor: ImageActor,
        optimizer: torch.optim.Optimizer,
        augment: Augment,
        *,
        epochs: int,
        batch_size: int,
    ) -> None:
        """Take the worlds and their network.

        Args:
            worlds: The worlds.
            actor: Their network, of which the optimizer has the part that estimates.
            optimizer: Optimizer of that part.
            augment: Random changes of the images that are learned from.
            epochs: Number of passes over a rollout.
            batch_size: Number of images in an update.
        """
        super().__init__()
        self._worlds, self._network, self._optimizer = worlds, actor, optimizer
        self._augment, self._epochs, self._batch_size = augment, epochs, batch_size

    def _on_rollout_end(self) -> None:
        device, kept, losses = device_of(self._network), self._worlds.kept(), []
        for _ in range(self._epochs):
            for rows in torch.randperm(len(kept["state"])).split(self._batch_size):
                drawn = {name: values[rows] for name, values in kept.items()}
                drawn["image"] = self._augment.as_images(drawn["image"])
                seen = {name: values.to(device) for name, values in drawn.items()}
                found = self._network.state(seen["image"], seen["pusher"], seen.get("goal"))
                loss = estimation_loss(found, seen["state"])
                self._optimizer.zero_grad()
                loss.backward()
                self._optimizer.step()
                losses.append(float(loss.detach()))
        self.logger.record("train/estimation_loss", float(np.mean(losses)))

    def _on_step(self) -> bool:
        return True
