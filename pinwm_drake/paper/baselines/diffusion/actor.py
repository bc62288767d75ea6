# SPDX-License-Identifier: MIT
"""A trained diffusion policy: it draws a sequence of actions, carries some out, and draws again."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic_core import to_jsonable_python
from torch import nn

from pinwm_drake.errors import require
from pinwm_drake.experiments.evaluation.formats import PolicyFormat
from pinwm_drake.learning.policy import WEIGHTS_FILE, read_parts, write_parts
from pinwm_drake.learning.spec import PolicySpec, seen_parts
from pinwm_drake.learning.weights import device_of
from pinwm_drake.paper.baselines.diffusion.network import DiffusionNetwork, require_diffusers
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions
from pinwm_drake.validation import from_document

ACTOR_FILE = "diffusion.yaml"


@dataclass(frozen=True, eq=False)
class Chunks:
    """State of a diffusion policy in W worlds.

    Attributes:
        image: (W, To, height, width, 3) uint8, RGB: the last images, the oldest first.
        pusher: (W, To, n) float32, positions of the pusher then, as it was seen.
        action: (W, Ta, n) float32, in [-1, 1]: the actions that were drawn last.
        step: (W,) int, number of actions that were taken in the episode.
    """

    image: np.ndarray
    pusher: np.ndarray
    action: np.ndarray
    step: np.ndarray


@dataclass(frozen=True, eq=False)
class DiffusionActor:
    """Policy that draws sequences of actions by taking noise away.

    The noise follows from the seed, the number of actions before it in its episode, and what is seen, so that an
    episode repeats in whatever world, and after whatever episodes, it runs.

    Attributes:
        spec: Specification of its inputs and outputs; the last image of a stack is seen, whatever `frames` is.
        network: The network.
        seed: Seed of the noise, 0 or more.
        provenance: Data, settings, versions and results of its training; plain data.

    Raises:
        ParameterError: diffusers is not installed, the seed is negative, or the policy's task draws goals or the
            policy observes no images.
    """

    spec: PolicySpec
    network: DiffusionNetwork
    seed: int = 0
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_diffusers()
        require("seed", self.seed, self.seed >= 0, "0 or more")
        require("observes", self.spec.observes, self.spec.observes == "rgb", "rgb")
        require("task", f"{self.spec.task.name} that draws goals", self.spec.task.goal_size == 0, "one that draws none")

    def predict(
        self,
        observation: Any,
        state: Chunks | None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[np.ndarray, Chunks]:
        """Actions (n,) or (W, n) in [-1, 1]^n, and the state to be given with the next observation; see `Acts`.

        What is observed has `image` and `pusher`; noise is drawn, whatever `deterministic` is.

        Raises:
            ParameterError: The observation lacks an entry, or the state is of other worlds.
        """
        image, pusher = seen_parts(observation, "image", "pusher")
        single = image.ndim == 3
        if single:
            image, pusher = image[None], pusher[None]
        chunks = self._see(image[..., -3:], pusher.astype(np.float32), state, episode_start)
        at = chunks.step % self.network.options.actions
        rows = np.flatnonzero(at == 0)
        if len(rows):
            chunks.action[rows] = self._draw(chunks, rows)
        actions: np.ndarray = chunks.action[np.arange(len(at)), at]
        chunks.step[:] += 1
        return (actions[0] if single else actions), chunks

    def _see(self, image: np.ndarray, pusher: np.ndarray, state: Chunks | None, starts: Any) -> Chunks:
        """State with the newest observation of each world, in arrays of its own."""
        W, options = len(image), self.network.options
        if state is None:
            starts = np.ones(W, bool)
            action = np.zeros((W, options.actions, pusher.shape[1]), np.float32)
            images, pushers = (np.repeat(part[:, None], options.observations, 1) for part in (image, pusher))
            state = Chunks(images, pushers, action, np.zeros(W, int))
        given, allowed = (state.image.shape[0], *state.image.shape[2:]), image.shape
        require("state", f"one of images {given}", given == allowed, f"one of images {allowed}, as are seen now")
        starts = np.zeros(W, bool) if starts is None else np.asarray(starts, bool)
        images, pushers = _rolled(state.image, image, starts), _rolled(state.pusher, pusher, starts)
        return Chunks(images, pushers, state.action.copy(), np.where(starts, 0, state.step))

    def _draw(self, chunks: Chunks, rows: np.ndarray) -> np.ndarray:
        """Actions (m, Ta, n) that are carried out next in some worlds (m,)."""
        options = self.network.options
        image, pusher = chunks.image[rows], chunks.pusher[rows]
        noise = np.stack([self._noise(*one) for one in zip(image, pusher, chunks.step[rows], strict=True)])
        images, pushers, noises = (torch.from_numpy(one).to(device_of(self.network)) for one in (image, pusher, noise))
        dark = 1.0 - images.permute(0, 1, 4, 2, 3).flatten(1, 2).float() / 255.0
        found = self.network.sample(dark, pushers, noises).cpu()
        first = options.observations - 1
        return np.clip(found[:, first : first + options.actions].numpy(), -1.0, 1.0)

    def _noise(self, image: np.ndarray, pusher: np.ndarray, step: int) -> np.ndarray:
        """Return the standard normal noise (Th, n) of one world."""
        digest = hashlib.blake2b(image.tobytes() + pusher.tobytes(), digest_size=16).digest()
        generator = np.random.default_rng([self.seed, int(step), int.from_bytes(digest, "little")])
        return generator.standard_normal((self.network.options.horizon, pusher.shape[1]), np.float32)


def _rolled(before: np.ndarray, now: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return the last observations (W, To, ...) with the newest (W, ...), which fills all at an episode's start."""
    found = np.concatenate([before[:, 1:], now[:, None]], axis=1)
    found[starts] = now[starts][:, None]
    return found


def write_actor(folder: Path, actor: DiffusionActor) -> None:
    """Write a diffusion policy over an earlier one of the folder; see `write_parts`."""
    settings = {"network": asdict(actor.network.options), "seed": actor.seed}
    write_parts(folder / ACTOR_FILE, actor.spec, actor.network, actor.provenance, **to_jsonable_python(settings))


def read_actor(folder: Path) -> DiffusionActor:
    """Read the diffusion policy that `write_actor` wrote to a folder.

    Raises:
        InputError: A file is missing, cannot be read, or does not fit the other.
        ParameterError: diffusers is not installed.
    """
    require_diffusers()

    def make(spec: PolicySpec, document: Mapping[str, Any]) -> tuple[DiffusionActor, nn.Module]:
        options = from_document(NetworkOptions, document.get("network"), "network")
        network = DiffusionNetwork(options, spec.action_size).eval()
        return DiffusionActor(spec, network, int(document["seed"]), document["provenance"]), network

    return read_parts(folder / ACTOR_FILE, make, "what `write_actor` wrote")


FORMAT = PolicyFormat(WEIGHTS_FILE, read_actor)
