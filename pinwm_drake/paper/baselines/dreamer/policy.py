# SPDX-License-Identifier: MIT
"""Policy of Dreamer V2, which remembers what it saw; on disk a folder of YAML and npz."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from pinwm_drake.errors import require
from pinwm_drake.experiments.evaluation.formats import PolicyFormat
from pinwm_drake.learning.policy import WEIGHTS_FILE, read_parts, write_parts
from pinwm_drake.learning.spec import PolicySpec, seen_parts
from pinwm_drake.learning.weights import device_of
from pinwm_drake.paper.baselines.dreamer.behaviour import Actor
from pinwm_drake.paper.baselines.dreamer.options import NetworkOptions
from pinwm_drake.paper.baselines.dreamer.world_model import Latent, Perception
from pinwm_drake.validation import from_document

DREAMER_FILE = "dreamer.yaml"
Memory = tuple[Latent, torch.Tensor]  # the latent state, and the action that was taken in it


@dataclass(frozen=True, eq=False)
class DreamerPolicy:
    """Encoder, latent dynamics and actor, and the meaning of their inputs and outputs.

    Attributes:
        spec: Specification; of its frames the last one is seen, as the state remembers those before.
        networks: Sizes of the networks.
        perception: Encoder and latent dynamics.
        actor: The actor.
        provenance: Seeds, settings and versions of its training; plain data.
    """

    spec: PolicySpec
    networks: NetworkOptions
    perception: Perception
    actor: Actor
    provenance: dict[str, Any] = field(default_factory=dict)

    def predict(
        self, observation: Any, state: Memory | None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Memory]:
        """Actions (n,) or (W, n) in [-1, 1]^n, and the state to be given with the next observation; see `Acts`.

        What is observed has `image` and `pusher`. Latents and actions are the likeliest ones, or drawn by torch's
        generator where `deterministic` is false.

        Raises:
            ParameterError: An entry is not in the observation, or the state is of another number of worlds.
        """
        device = device_of(self.actor)
        image, pusher = (torch.from_numpy(part).to(device) for part in seen_parts(observation, "image", "pusher"))
        single = image.ndim == 3
        if single:
            image, pusher = image[None], pusher[None]
        W = len(image)
        with torch.inference_mode():
            if state is None:
                state = (self.perception.rssm.initial(W), torch.zeros(W, self.spec.action_size, device=device))
            latent, action = state
            require("state", f"one of {len(action)} worlds", len(action) == W, f"one of {W}, as are observed")
            starts = np.zeros(W, bool) if episode_start is None else np.asarray(episode_start, bool)
            first = torch.from_numpy(starts).to(device)
            embed = self.perception.embed(image[..., -3:], pusher.float())
            latent, _ = self.perception.rssm.see(latent, action, embed, first, mode=deterministic)
            found = self.actor(latent.features)
            action = found.mean if deterministic else found.rsample()
        actions: np.ndarray = action.cpu().numpy().copy()
        return (actions[0] if single else actions), (latent, action)


def make_policy(spec: PolicySpec, networks: NetworkOptions) -> DreamerPolicy:
    """Return an untrained policy; raises ParameterError for a specification that cannot be learned."""
    size = image_size(spec)
    perception, actor = Perception(size, spec.action_size, networks), Actor(spec.action_size, networks)
    return DreamerPolicy(spec, networks, perception.eval(), actor.eval())


def image_size(spec: PolicySpec) -> int:
    """Side of the images [px] of a specification; raises ParameterError where Dreamer cannot learn such a policy."""
    camera = spec.camera
    require("camera", f"{camera.width} x {camera.height} px", camera.width == camera.height, "square images")
    require("observes", spec.observes, spec.observes == "rgb", "rgb")
    require("task", "goals that episodes draw", not spec.task.goal_size, "one goal, which no image shows")
    return camera.height


def write_dreamer(folder: Path, policy: DreamerPolicy) -> None:
    """Write a policy over an earlier one of the folder; see `write_parts`."""
    path, sizes = folder / DREAMER_FILE, asdict(policy.networks)
    write_parts(path, policy.spec, _network(policy), policy.provenance, networks=sizes)


def read_dreamer(folder: Path) -> DreamerPolicy:
    """Read the policy that `write_dreamer` wrote to a folder.

    Raises:
        InputError: A file is missing, cannot be read, or does not fit the other.
    """

    def make(spec: PolicySpec, document: Mapping[str, Any]) -> tuple[DreamerPolicy, nn.Module]:
        policy = make_policy(spec, from_document(NetworkOptions, document.get("networks"), "networks"))
        return replace(policy, provenance=document["provenance"]), _network(policy)

    return read_parts(folder / DREAMER_FILE, make, "a policy of Dreamer V2")


def _network(policy: DreamerPolicy) -> nn.Module:
    return nn.ModuleDict({"perception": policy.perception, "actor": policy.actor})


FORMAT = PolicyFormat(WEIGHTS_FILE, read_dreamer)
