# SPDX-License-Identifier: MIT
"""Untrained policies of images and their bundles, for tests."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError
from pinwm_drake.learning.bundle import (
    PROVENANCE_FILE,
    provenance_hash,
    read_bundle,
)
from pinwm_drake.learning.export import export_policy
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.learning.spec import CameraSpec, ObjectSpec, PolicySpec, PusherSpec, SceneSpec
from pinwm_drake.tasks.push import PushTask

LOW, HIGH, LONGEST = (-0.3, -0.2), (0.25, 0.35), 0.02
SCENE = SceneSpec(
    ObjectSpec("block", "0123456789abcdef" * 4, (0.1, 0.14, 0.05), (0.0, -0.02, 0.0)),
    PusherSpec("capsule", 0.01, 0.04),
    0.003,
)


def image_spec(size: int = 32, frames: int = 2, **changes: Any) -> PolicySpec:
    """Of a camera that looks down from 1 m; the box is not symmetric, so that a wrong sign or middle shows."""
    values = {
        "observes": "rgb",
        "frames": frames,
        "camera": CameraSpec(size, size, 1.5 * size, 1.5 * size, size / 2, size / 2, (0, 0, 1), (0, 1, 0, 0)),
        "horizon": 0.1,
        "max_translation": LONGEST,
        "pusher_low": LOW,
        "pusher_high": HIGH,
        "pusher_height": 0.02,
        "task": PushTask(),
        "max_steps": 100,
    }
    return PolicySpec(**(values | changes))


def untrained_policy(spec: PolicySpec, gain: float = 1.5) -> Policy:
    """A policy whose logits spread by `gain` about 0 at `pictures`, so that all levels are taken somewhere."""
    torch.manual_seed(0)
    actor = make_actor(spec).eval()
    images, _ = pictures(spec, 40)
    with torch.no_grad():
        pusher = torch.rand(40, spec.pusher_size) * 2 - 1
        logits = actor.head(actor.latent({"image": torch.from_numpy(images), "pusher": pusher}))
        scale = gain / logits.std(0)
        actor.head.bias.copy_((actor.head.bias - logits.mean(0)) * scale)
        actor.head.weight.mul_(scale[:, None])
    return Policy(spec, actor, {"twin": "of a test", "seed": 0})


def pictures(spec: PolicySpec, number: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Dark rectangles on white, and positions in the pusher's box and somewhat beyond."""
    generator = np.random.default_rng(1)
    images = np.full((number, *spec.image_shape), 255, np.uint8)
    for image in images:
        row, column = generator.integers(0, spec.camera.height // 2, 2)
        colors = generator.integers(0, 200, image.shape[2], np.uint8)
        image[row : row + spec.camera.height // 3, column : column + spec.camera.width // 2] = colors
    low, high = np.array(spec.pusher_low), np.array(spec.pusher_high)
    return images, low + (high - low) * generator.uniform(-0.1, 1.1, (number, 2))


def exported(folder: Path, policy: Policy) -> Path:
    """The folder of its bundle."""
    export_policy(policy, folder, limits=default_limits(policy.spec), samples=pictures(policy.spec))
    return folder


def rehash(folder: Path, **changes: Any) -> None:
    """Makes a provenance fit files that were changed, as someone would who means it."""
    path = folder / PROVENANCE_FILE
    document = json.loads(path.read_text()) | changes
    for name in document["files"] or {}:
        document["files"][name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    document["sha256"] = provenance_hash(document)
    path.write_text(json.dumps(document))


def refused(folder: Path, name: str | None) -> str:
    """The message of the error, less the file that it names."""
    with pytest.raises(InputError) as error:
        read_bundle(folder)
    path = folder if name is None else folder / name
    assert error.value.path == str(path)
    assert "; allowed: " in str(error.value)
    message = str(error.value)
    if not message.startswith("..."):
        return message.removeprefix(str(path))
    return message.partition(f"/{path.name}")[2]  # of a long path, the end is told
