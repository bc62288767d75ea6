# SPDX-License-Identifier: MIT
"""Export of a policy as a bundle: torch to ONNX, with the contract, golden samples and the SHA-256 of each."""

import contextlib
import copy
import logging
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from pinwm_drake.documents import yaml_text
from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.learning.bundle import (
    CONTRACT_FILE,
    GOLDEN_FILE,
    ONNX_FILE,
    Bundle,
    check_golden,
    write_bundle,
)
from pinwm_drake.learning.contract import (
    ESTIMATE,
    GOAL,
    IMAGE,
    OPSET,
    POSITION,
    SCHEMA_VERSION,
    TRANSLATION,
    ArmCheck,
    make_contract,
)
from pinwm_drake.learning.golden import Golden
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.runtime import Network
from pinwm_drake.learning.safety import SafetyLimits, default_limits
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.provenance import timestamp, versions

_MARGIN = 1e-3  # in logits, beyond what rounding does
_LIBRARIES = ("torch", "onnx", "onnxscript", "onnxruntime", "numpy")


class InMetres(nn.Module):
    """An actor in physical units: one image stack and a position in metres in, a translation in metres out.

    Its estimate of the task's state comes out beside it where that is asked for.
    """

    middle: Tensor
    reach: Tensor

    def __init__(self, spec: PolicySpec, actor: ImageActor, *, estimate: bool = True) -> None:
        """Take a copy of the actor, on the CPU.

        Args:
            spec: Specification of the policy.
            actor: Network from images and positions in [-1, 1]^n to actions.
            estimate: Flag: the estimate of the state comes out too.
        """
        super().__init__()
        self.actor = copy.deepcopy(actor).cpu()
        for name, values in zip(("middle", "reach"), spec.pusher_scales(), strict=True):
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32))
        self.max_translation, self.estimate, self.task = spec.max_translation, estimate, spec.task
        self.eval()

    def forward(self, image: Tensor, p_WP: Tensor, goal: Tensor | None = None) -> Tensor | tuple[Tensor, Tensor]:
        """Return the translation d_W (n,) m for an image (height, width, 3 k) uint8 and a position (pusher_size,) m.

        The position goes on with the history, where there is one. The goal (goal_size,) is that of the episode, where
        the policy is told one.
        """
        pusher = ((p_WP - self.middle) / self.reach).clamp(-1.0, 1.0)
        told = None if goal is None else goal[None]
        state = self.actor.state(image[None], pusher[None], told)
        actions = self.actor.actor(state)
        action: Tensor = (actions if told is None else self.task.world_action(actions, told))[0]
        length = (action * action).sum().sqrt().clamp(min=1.0)
        d_W = self.max_translation * action / length
        return (d_W, state[0, : self.task.state_size]) if self.estimate else d_W


def export_policy(
    policy: Policy,
    folder: Path,
    *,
    limits: SafetyLimits,
    samples: tuple[np.ndarray, ...],
    estimate: bool = True,
    arms: Sequence[ArmCheck] = (),
) -> Bundle:
    """Write a bundle, which appears whole or not at all, and read it back.

    Args:
        policy: A policy that observes "rgb".
        folder: Folder of the bundle, new or empty.
        limits: Limits of the pusher's motion that a controller is to keep.
        samples: Images (n, height, width, 3 k) uint8, positions p_WP (n, pusher_size) m and, where the policy is told
            them, goals (n, goal_size) of a run of the policy, n of 1 or more. A few that no run has, with positions
            beyond the box, are added.
        estimate: Flag: the network gives its estimate of the state; false where it was not taught the state.
        arms: Checks of arms, for the contract.

    Returns:
        The bundle, as it was read back.

    Raises:
        ParameterError: It does not observe images, or the samples do not fit it.
        InputError: The folder holds something or cannot be written to, or the network in ONNX answers otherwise.
    """
    require_exportable(policy)
    spec, golden = policy.spec, golden_samples(policy, *samples, estimate=estimate)
    contract = make_contract(spec, limits, golden.mask_pixels(), estimate=estimate, arms=arms)
    files = {
        ONNX_FILE: onnx_bytes(policy, estimate=estimate),
        CONTRACT_FILE: yaml_text(dict(contract)).encode(),
        GOLDEN_FILE: golden.to_bytes(),
    }
    network = Network(files[ONNX_FILE], Path(ONNX_FILE), contract)
    provenance = {
        "schema_version": SCHEMA_VERSION,
        "made": timestamp(),
        "versions": versions(_LIBRARIES),
        "golden": {
            "samples": len(golden.d_W),
            "deviation_from_torch": check_golden(folder / GOLDEN_FILE, network, golden),
            "unit": "m",
        },
        "policy": policy.provenance,
    }
    return write_bundle(folder, files, provenance)


def check_exportable(spec: PolicySpec) -> None:
    """Export a network that was not trained, to nowhere, so that a training need not end in what no bundle takes.

    Args:
        spec: Specification of a policy that observes "rgb".

    Raises:
        ParameterError: Limits do not follow from the specification, or torch cannot write the network in ONNX.
        InputError: The network in ONNX cannot be loaded, is not what a contract of the specification says, or answers
            otherwise.
    """
    policy = Policy(spec, make_actor(spec).eval())
    require_exportable(policy)
    middle = spec.pusher_metres(np.zeros(spec.pusher_size))
    goals = np.zeros((1, spec.task.goal_size))
    golden = golden_samples(policy, np.zeros((1, *spec.image_shape), np.uint8), middle[None], goals)
    contract = make_contract(spec, default_limits(spec), golden.mask_pixels())
    try:
        content = onnx_bytes(policy)
    except Exception as error:  # torch's errors have no base of their own
        message = " ".join(str(error).split())[:200]
        raise ParameterError(f"policy: torch cannot export its network ({message}); train one without that") from error
    check_golden(Path(GOLDEN_FILE), Network(content, Path(ONNX_FILE), contract), golden)


def require_exportable(policy: Policy) -> None:
    """Raise ParameterError where a policy does not observe images."""
    if policy.spec.observes != "rgb":
        raise ParameterError(f"policy: got one that observes {policy.spec.observes}; allowed: rgb, as bundles do")


def golden_samples(
    policy: Policy, images: np.ndarray, p_WP: np.ndarray, goal: np.ndarray | None = None, *, estimate: bool = True
) -> Golden:
    """Sample with the policy's actions, worked out as its environment does it and not as `InMetres`.

    Beside those given there are four: an empty image and one of random blocks, each with the pusher in the upper corner
    of its box and beyond the lower one. Samples in which rounding decides between two levels are left out.

    Args:
        policy: A policy that observes "rgb".
        images: (n, height, width, 3 k) uint8, RGB.
        p_WP: (n, pusher_size) m, world: positions of the pusher along the axes of the task, with their history.
        goal: (n, goal_size) goals of the episodes; None where they have that of the task.
        estimate: Flag: the policy's estimates of the state are kept too.

    Raises:
        ParameterError: A shape or type is another, a number is not finite, or there is no sample.
    """
    spec = policy.spec
    images, p_WP = np.asarray(images), np.asarray(p_WP, np.float32)
    if images.dtype != np.uint8 or images.shape[1:] != spec.image_shape or len(images) < 1:
        wanted = f"uint8 (n, {', '.join(map(str, spec.image_shape))}) with n of 1 or more"
        raise ParameterError(f"samples: got images of {images.dtype} {images.shape}; allowed: {wanted}")
    if p_WP.shape != (shape := (len(images), spec.pusher_size)) or not np.isfinite(p_WP).all():
        raise ParameterError(f"samples: got positions {p_WP.shape}; allowed: {shape} finite numbers, m")
    size = spec.task.goal_size
    goal = np.zeros((len(images), 0)) if goal is None else np.asarray(goal)
    if goal.shape != (len(images), size) or not np.isfinite(goal).all():
        raise ParameterError(f"samples: got goals {goal.shape}; allowed: {(len(images), size)} finite numbers")
    low, high = (spec.pusher_metres(np.full(spec.pusher_size, end)).astype(np.float32) for end in (-1.0, 1.0))
    height, width, channels = spec.image_shape
    blocks = np.random.default_rng(0).integers(0, 256, (-(-height // 8), -(-width // 8), channels), np.uint8)
    noise = np.kron(blocks, np.ones((8, 8, 1), np.uint8))[:height, :width]
    empty = np.full(spec.image_shape, 255, np.uint8)
    beyond = low - 0.5 * (high - low)
    images = np.concatenate([images, np.stack([empty, noise, empty, noise])])
    p_WP = np.concatenate([p_WP, np.stack([high, high, beyond, beyond])])
    goal = np.concatenate([goal, np.tile(goal[:1], (4, 1))]).astype(np.float32)
    pusher = spec.pusher_seen(p_WP)
    seen = {"image": images, "pusher": pusher.astype(np.float32)} | ({"goal": goal} if size else {})
    action = policy.predict(seen)[0].astype(float)
    if not np.isfinite(action).all():
        raise ParameterError("policy: its actions are not finite numbers; train it anew")
    actor: Any = policy.actor
    given = {name: torch.from_numpy(part) for name, part in seen.items()}
    with torch.inference_mode():
        states = actor.state(given["image"], given["pusher"], given.get("goal"))
        decided = (actor.actor.margin(states) > _MARGIN).numpy()
    state: np.ndarray = states.numpy()
    if not decided.any():
        raise ParameterError("policy: it is undecided in all golden samples; train it further")
    images, p_WP, action = images[decided], p_WP[decided], action[decided]
    d_W = spec.max_translation * action / np.maximum(np.linalg.norm(action, axis=1, keepdims=True), 1.0)
    told = state[decided, : spec.task.state_size] if estimate else None
    return Golden(images, p_WP, d_W.astype(np.float32), told, goal[decided] if size else None)


def onnx_bytes(policy: Policy, *, estimate: bool = True) -> bytes:
    """Return the network of a policy of images as an ONNX file that holds its weights.

    Args:
        policy: A policy that observes "rgb".
        estimate: Flag: the network gives its estimate of the state too.
    """
    assert isinstance(policy.actor, ImageActor)
    images, size = torch.full(policy.spec.image_shape, 255, dtype=torch.uint8), policy.spec.task.goal_size
    with _quiet():
        program = torch.onnx.export(
            InMetres(policy.spec, policy.actor, estimate=estimate),
            (images, torch.zeros(policy.spec.pusher_size), *([torch.zeros(size)] if size else [])),
            input_names=[IMAGE, POSITION, *([GOAL] if size else [])],
            output_names=[TRANSLATION, ESTIMATE] if estimate else [TRANSLATION],
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise ParameterError("policy: torch.onnx.export made no network of it; use one that it can trace")
    model = program.model_proto
    # Torch notes for each node the lines of the source that it is from, with their paths on this machine.
    del model.metadata_props[:]
    for item in (model.graph, *model.graph.node, *model.graph.value_info, *model.graph.input, *model.graph.output):
        del item.metadata_props[:]
        item.doc_string = ""
    content: bytes = model.SerializeToString()
    return content


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppresses warnings of torch.onnx on torchvision, and on functions of its own that it should not call."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
