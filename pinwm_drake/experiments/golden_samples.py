# SPDX-License-Identifier: MIT
"""A trained policy as a bundle, with golden samples from a scene in which it acts."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.errors import InputError, require
from pinwm_drake.experiments.progress import Progress, silent
from pinwm_drake.files import appearing
from pinwm_drake.learning.bundle import Bundle, is_bundle, read_bundle
from pinwm_drake.learning.contract import ArmCheck
from pinwm_drake.learning.export import export_policy, require_exportable
from pinwm_drake.learning.policy import Policy, read_policy
from pinwm_drake.learning.safety import SafetyLimits, default_limits
from pinwm_drake.systems.arm.check import ToolMotion, check_arm
from pinwm_drake.systems.arm.model import ARMS
from pinwm_drake.systems.envs.policy_scene import policy_setup, scene_spec, spec_environment
from pinwm_drake.systems.scenario.load import Scene

_OWN = "golden samples show it"
_EPISODES, _ACTIONS, _EVERY = 3, 13, 4


def export_bundle(
    folder: Path,
    out: Path,
    *,
    scene: str | None = None,
    seed: int = 0,
    limits: Mapping[str, Any] | None = None,
    arms: bool = True,
    progress: Progress = silent,
) -> Bundle:
    """Write the bundle of a policy, with golden samples that it sees in a scene.

    A policy that was not taught the state (`pinwm train --method ppo`) gives no estimate of it.

    Args:
        folder: Folder of the policy.
        out: Folder of the bundle, new or empty.
        scene: Scene of the golden samples: see `spec_environment`; None for the policy's own, `home_scene`.
        seed: Seed of the first episode's start, 0 or more.
        limits: Values of `SafetyLimits` in the place of the default ones, by name.
        arms: Flag: simulated arms are checked too, and the contract tells which follow the policy's motions.
        progress: Called with stages "acting", for the golden samples, "checking arms", and "exporting".

    Returns:
        The bundle, as it was read back.

    Raises:
        PinwmError: The policy cannot be read or is not one of images, the scene is not one that it is made for, a limit
            is out of range, or the folder cannot be written.
    """
    folder, out = Path(folder), Path(out)  # of the face, where texts are given as well
    require("--seed", seed, seed >= 0, "0 or more")
    if is_bundle(folder):
        raise InputError(folder, value="a bundle", allowed="a policy, as `pinwm train` wrote it")
    policy = read_policy(folder)
    require_exportable(policy)
    spec, about = policy.spec, policy.provenance
    setup = policy_setup(spec, about, folder, scene, _OWN)
    if spec.scene is None:
        there = scene_spec(spec_environment(spec, setup, "twin").setup, spec.camera)
        policy = dataclasses.replace(policy, spec=dataclasses.replace(spec, scene=there))
    chosen = dataclasses.replace(default_limits(spec), **(limits or {}))
    taught = about.get("method") != "ppo" or bool(about.get("auxiliary", False))
    with appearing(out) as temporary:
        samples, motions = seen_samples(policy, setup, seed, lambda share: progress("acting", share, "golden samples"))
        checks = _checked_arms(policy, setup, chosen, motions, progress) if arms else []
        progress("exporting", 0.0, "network")
        export_policy(policy, temporary, limits=chosen, samples=samples, estimate=taught, arms=checks)
    return read_bundle(out)


def seen_samples(
    policy: Policy, scene: Scene, seed: int, report: Callable[[float], None] = lambda share: None
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], list[ToolMotion]]:
    """Samples and motions of a policy in the twin's station, in a few short episodes in which it acts.

    Args:
        policy: A policy of images.
        scene: Scene of the episodes; see `spec_environment`.
        seed: Seed of the first episode; the next ones count up from it.
        report: Called with the share of the episodes' actions that are made.

    Returns:
        Images (n, height, width, 3 k) uint8, positions of the pusher (n, pusher_size) m, world frame, along the
        task's axes, with their history, and goals of the episodes (n, goal_size). The motion of each episode.

    Raises:
        ParameterError: The scene is not one that the policy is made for.
        InputError: The scene cannot be used.
    """
    environment = spec_environment(policy.spec, scene, "twin", observation="rgb_state")
    images, p_WP, goals, motions = [], [], [], []
    for episode in range(_EPISODES):
        observation, _ = environment.reset(seed=seed + episode)
        start, actions = environment.worlds.run.p_WP[0].copy(), []
        for step in range(_ACTIONS):
            if step % _EVERY == 0:
                images.append(observation["image"])
                p_WP.append(policy.spec.pusher_metres(observation["pusher"]))
                goals.append(environment.worlds.goal[0])
            action, _ = policy.predict(observation)
            actions.append(action)
            observation, _, terminated, truncated, _ = environment.step(action)
            report((episode * _ACTIONS + step + 1) / (_EPISODES * _ACTIONS))
            if terminated or truncated:
                break
        d_W = policy.spec.task.translation(np.stack(actions), policy.spec.max_translation)
        motions.append(ToolMotion(start, d_W / policy.spec.horizon, policy.spec.horizon))
    return (np.stack(images), np.stack(p_WP), np.stack(goals)), motions


def _checked_arms(
    policy: Policy, scene: Scene, limits: SafetyLimits, motions: list[ToolMotion], progress: Progress
) -> list[ArmCheck]:
    setup, checks = spec_environment(policy.spec, scene, "twin").setup, []
    for k, arm in enumerate(ARMS):
        progress("checking arms", k / len(ARMS), arm)
        checks.append(check_arm(arm, setup, limits, motions))
    return checks
