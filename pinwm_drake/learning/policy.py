# SPDX-License-Identifier: MIT
"""A policy: a network with its specification, on disk as a folder of YAML and npz."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import nn

from pinwm_drake.checkpoints import read_arrays, write_arrays
from pinwm_drake.documents import read_yaml, yaml_text
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.learning.actors import ImageActor, state_actor
from pinwm_drake.learning.spec import PolicySpec, seen_parts
from pinwm_drake.learning.weights import device_of, set_weights, weights
from pinwm_drake.reading.trees import check_finite

POLICY_FILE, WEIGHTS_FILE = "policy.yaml", "weights.npz"
_VERSION = 2
_WEIGHTS_VERSION = 1
_Read = TypeVar("_Read")


@dataclass(frozen=True, eq=False)
class Policy:
    """A network that acts, and the meaning of its inputs and outputs.

    Attributes:
        spec: Specification of its inputs and outputs, and its task.
        actor: `ImageActor` where it observes "rgb", `StateActor` where it observes "state".
        provenance: Twin, seeds, settings, versions and results of its training; plain data.
    """

    spec: PolicySpec
    actor: nn.Module
    provenance: dict[str, Any] = field(default_factory=dict)

    def predict(
        self, observation: Any, state: None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, None]:
        """Actions (n,) or (B, n) in [-1, 1]^n, with the signature of SB3's `predict`; the policy has no state.

        Args:
            observation: Observation of one world or of B, as the environment gives it. A policy that observes "state"
                takes an array or a dict with `state`; one that observes "rgb" a dict with `image` and `pusher`. Where
                the task draws goals, `goal` is in the dict; a state without one is of the task's own goal. State and
                pusher have the history that the specification names.
            state: Not used.
            episode_start: Not used.
            deterministic: Not used: it always is.

        Raises:
            ParameterError: An entry that the policy sees is not in the observation.
        """
        names = ["state"] if self.spec.observes == "state" else ["image", "pusher"]
        if self.spec.task.goal_size and not isinstance(observation, np.ndarray):
            names.append("goal")
        bare = self.spec.observes == "state" and isinstance(observation, np.ndarray)
        seen = [observation] if bare else seen_parts(observation, *names)
        single = seen[0].ndim == (1 if self.spec.observes == "state" else 3)
        device = device_of(self.actor)
        given = [torch.from_numpy(part[None] if single else part).to(device) for part in seen]
        given = [part if name == "image" else part.float() for name, part in zip(names, given, strict=True)]
        with torch.inference_mode():
            if names[0] == "state":
                found = self.actor(given[0])
                found = self.spec.task.world_action(found, given[1]) if len(given) > 1 else found
            else:
                found = self.actor(*given)
            actions: np.ndarray = found.cpu().numpy()
        return (actions[0] if single else actions), None


def make_actor(spec: PolicySpec) -> nn.Module:
    """Return an untrained network for a specification."""
    return state_actor(spec) if spec.observes == "state" else ImageActor(spec)


def weights_digest(policy: Policy) -> str:
    """SHA-256 of the weights, which tells policies apart."""
    digest = hashlib.sha256()
    for name, value in sorted(weights(policy.actor).items()):
        digest.update(name.encode())
        digest.update(value.tobytes())
    return digest.hexdigest()


def write_policy(folder: Path, policy: Policy) -> None:
    """Write a policy over an earlier one of the folder; see `write_parts`."""
    write_parts(folder / POLICY_FILE, policy.spec, policy.actor, policy.provenance, version=_VERSION)


def read_policy(folder: Path) -> Policy:
    """Read the policy that `write_policy` wrote to a folder.

    Raises:
        InputError: A file is missing, cannot be read, or does not fit the other.
    """

    def make(spec: PolicySpec, document: Mapping[str, Any]) -> tuple[Policy, nn.Module]:
        actor = make_actor(spec).eval()
        return Policy(spec, actor, document["provenance"]), actor

    return read_parts(folder / POLICY_FILE, make, "policy.yaml that `pinwm train` wrote", version=_VERSION)


def write_parts(
    path: Path,
    spec: PolicySpec,
    network: nn.Module,
    provenance: Mapping[str, Any],
    /,
    *,
    version: int = 1,
    **settings: Any,
) -> None:
    """Write a policy of any method over an earlier one; each file appears whole or not at all.

    Args:
        path: Its document; the weights are beside it, and the folder is made if need be.
        spec: Specification of its inputs and outputs.
        network: Network with all weights.
        provenance: Origin as plain data.
        version: The document's schema_version.
        settings: Further entries of the document, plain data.

    Raises:
        InputError: A file cannot be written.
    """
    prepare_folder(path.parent)
    write_arrays(path.with_name(WEIGHTS_FILE), {"schema_version": _WEIGHTS_VERSION}, weights(network))
    document = {"schema_version": version, "spec": spec.to_document(), **settings, "provenance": dict(provenance)}
    with replacing(path) as temporary:
        temporary.write_text(yaml_text(document), encoding="utf-8")


def read_parts(
    path: Path,
    make: Callable[[PolicySpec, Mapping[str, Any]], tuple[_Read, nn.Module]],
    allowed: str,
    *,
    version: int = 1,
) -> _Read:
    """Read a policy that `write_parts` wrote.

    Args:
        path: Its document.
        make: Makes the policy from specification and document, and tells the network that the weights are for.
        allowed: Words on what the document should be, for messages.
        version: The document's schema_version.

    Raises:
        InputError: A file is missing, cannot be read, or does not fit the other.
    """
    document = read_yaml(path).value
    if not isinstance(document, dict) or document.get("schema_version") != version:
        raise InputError(path, value="another document", allowed=f"{allowed}, with schema_version {version}")
    try:
        spec, provenance = PolicySpec.from_document(document.get("spec")), dict(document.get("provenance") or {})
        check_finite(provenance, path)
        policy, network = make(spec, document | {"provenance": provenance})
    except (ParameterError, KeyError, TypeError, ValueError) as error:
        raise InputError(path, value=error, allowed=allowed) from error
    path = path.with_name(WEIGHTS_FILE)
    arrays = read_arrays(path, {"schema_version": _WEIGHTS_VERSION}, "policy")
    if arrays is None:
        raise InputError(path, value="no such file", allowed="the weights beside the policy's document")
    try:
        set_weights(network, arrays)
    except ParameterError as error:
        raise InputError(path, value=error, allowed="weights of the network in the policy's document") from error
    return policy
