# SPDX-License-Identifier: MIT
"""`pinwm export`: the contents of the bundle in a few lines."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.experiments.requests.control import ExportRequest

if TYPE_CHECKING:
    from pinwm_drake.learning.bundle import Bundle

_CALLS = 100  # calls of the network that are timed


def export(request: ExportRequest) -> None:
    """Write a policy as a bundle, which onnxruntime alone can run.

    A bundle holds the network in ONNX, its contract, safety limits and golden samples.
    """
    from pinwm_drake.experiments.golden_samples import export_bundle

    with stages_bar(transient=True) as progress:
        bundle = export_bundle(
            request.policy,
            request.bundle,
            scene=request.scene,
            seed=request.seed,
            limits=request.limits,
            arms=request.arms,
            progress=progress,
        )
    for line in _described(bundle, request.bundle):
        say(line)


def _described(bundle: "Bundle", folder: Path) -> list[str]:
    """Lines on a bundle: limits, golden samples, the time of a call, and files."""
    import numpy as np

    from pinwm_drake.learning.contract import ArmCheck

    golden, limits, task = bundle.provenance["golden"], bundle.limits, bundle.spec.task
    acting = bundle.toward([0.0] * task.goal_size) if task.goal_size else bundle
    image = np.full(bundle.spec.image_shape, 255, np.uint8)
    p_WP = bundle.spec.pusher_metres(np.zeros(bundle.spec.pusher_size))
    seconds = []
    for _ in range(_CALLS):
        start = time.perf_counter()
        acting.act(image, p_WP)
        seconds.append(time.perf_counter() - start)
    low, high = (" ".join(f"{value:g}" for value in corner) for corner in (limits.box_low, limits.box_high))
    return [
        f"limits: {limits.max_speed:.3g} m/s, {limits.max_acceleration:.3g} m/s^2, image no older than "
        f"{limits.max_image_age:g} s, pusher within {low} to {high} m",
        f"{golden['samples']} golden samples; onnxruntime is {golden['deviation_from_torch']:.1e} m from torch at most",
        f"{1e3 * np.median(seconds):.2f} ms a call on one core",
        *(str(ArmCheck.from_document(one)) for one in bundle.contract.get("arms", [])),
        *(f"wrote {path} ({path.stat().st_size / 1e3:.1f} kB)" for path in sorted(folder.iterdir())),
        f"SHA-256 of the bundle: {bundle.sha256}",
    ]
