"""What `pinwm export` does."""

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from pinwm_drake.errors import ParameterError
from pinwm_drake.files import appearing
from pinwm_drake.learning.bundle import Bundle, read_bundle
from pinwm_drake.learning.export import export_policy, require_images
from pinwm_drake.learning.policy import Policy, read_policy
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.systems.envs.policy_scene import spec_environment

_EPISODES, _ACTIONS, _EVERY = 3, 13, 4
_CALLS = 100


def run_export(folder: Path, out: Path, *, scene: str, seed: int, limits: dict[str, Any]) -> None:
    """Writes the bundle of a policy, and says what is in it.

    Args:
        folder: The policy's.
        out: The bundle's: new or empty.
        scene: In which the golden samples are seen.
        seed: Of where their episodes start.
        limits: Of `SafetyLimits`, in the place of the default ones.

    Raises:
        PinwmError: The policy cannot be read or is not one of images, the scene is not one that it is made for, a limit
            is out of range, or the folder cannot be written.
    """
    if seed < 0:
        raise ParameterError(f"--seed: got {seed}; allowed: 0 or more")
    policy = read_policy(folder)
    require_images(policy)
    chosen = dataclasses.replace(default_limits(policy.spec), **limits)
    with appearing(out) as temporary:
        export_policy(policy, temporary, limits=chosen, samples=seen_samples(policy, scene, seed))
    _report(Console(), out, read_bundle(out))


def seen_samples(policy: Policy, scene: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """What the policy sees in the twin's station in a few short episodes in which it acts.

    Args:
        policy: Of images.
        scene: See `spec_environment`.
        seed: Of the first episode.

    Returns:
        Images (n, height, width, 3 k) uint8, and positions of the pusher (n, 2) m.

    Raises:
        ParameterError: The scene is not one that the policy is made for.
        InputError: The scene cannot be used.
    """
    environment = spec_environment(policy.spec, scene, "twin", observation="rgb_state")
    images, p_WP = [], []
    for episode in range(_EPISODES):
        observation, _ = environment.reset(seed=seed + episode)
        for step in range(_ACTIONS):
            if step % _EVERY == 0:
                images.append(observation["image"])
                p_WP.append(environment.run.p_WP[0, :2].copy())
            action, _ = policy.predict(observation)
            observation, _, terminated, truncated, _ = environment.step(action)
            if terminated or truncated:
                break
    return np.stack(images), np.stack(p_WP)


def _report(console: Console, out: Path, bundle: Bundle) -> None:
    golden, limits = bundle.provenance["golden"], bundle.limits
    image, p_WP = np.full(bundle.spec.image_shape, 255, np.uint8), 0.5 * np.add(limits.box_low, limits.box_high)[:2]
    seconds = []
    for _ in range(_CALLS):
        start = time.perf_counter()
        bundle.act(image, p_WP)
        seconds.append(time.perf_counter() - start)
    low, high = (" ".join(f"{value:g}" for value in corner) for corner in (limits.box_low, limits.box_high))
    lines = (
        f"limits: {limits.max_speed:.3g} m/s, {limits.max_acceleration:.3g} m/s^2, image no older than "
        f"{limits.max_image_age:g} s, pusher within {low} to {high} m",
        f"{golden['samples']} golden samples; onnxruntime is {golden['deviation_from_torch']:.1e} m from torch at most",
        f"{1e3 * np.median(seconds):.2f} ms a call on one core",
        *(f"wrote {path} ({path.stat().st_size / 1e3:.1f} kB)" for path in sorted(out.iterdir())),
        f"SHA-256 of the bundle: {bundle.sha256}",
    )
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)
