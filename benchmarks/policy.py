# SPDX-License-Identifier: MIT
"""Milliseconds a call of a policy on one core: the bundle in onnxruntime, and the same network in torch.

The policy sees three images of 64 x 64 px; it is untrained, which makes no difference to its price. `Bundle.act` goes
from the image and the pusher's position in metres to a translation in metres, checks included, as a controller calls
it; so does the torch module that it was exported from. `Policy.predict` is what an environment calls.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks import results, timing

if __name__ == "__main__":
    timing.limit_threads(1)  # before torch and onnxruntime are imported

import numpy as np
import torch

from pinwm_drake.learning.bundle import read_bundle
from pinwm_drake.learning.export import InMetres, export_policy
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.learning.spec import CameraSpec, PolicySpec
from pinwm_drake.tasks.push import PushTask

SIZE, FRAMES = 64, 3
BAR = 1.0  # ms
CALLS, LOADS = 100, 10
BUNDLE, MODULE, PREDICT = "onnxruntime, Bundle.act", "torch, the same in metres", "torch, Policy.predict"


def make_policy() -> Policy:
    """Return an untrained policy."""
    camera = CameraSpec(SIZE, SIZE, 88.0, 88.0, SIZE / 2, SIZE / 2, (0.0, 0.0, 0.7), (0.0, 1.0, 0.0, 0.0))
    spec = PolicySpec(
        observes="rgb",
        frames=FRAMES,
        camera=camera,
        horizon=0.1,
        max_translation=0.02,
        pusher_low=(-0.35, -0.35),
        pusher_high=(0.35, 0.35),
        pusher_height=0.025,
        task=PushTask(),
        max_steps=100,
    )
    torch.manual_seed(0)
    return Policy(spec, make_actor(spec).eval())


def measure(given: argparse.Namespace) -> dict:
    """Time policy, network and bundle in turn."""
    torch.set_num_threads(1)
    policy = make_policy()
    blocks = np.random.default_rng(0).integers(0, 256, (SIZE // 8, SIZE // 8, 3 * FRAMES), np.uint8)
    image, p_WP = np.kron(blocks, np.ones((8, 8, 1), np.uint8)), np.array([0.1, -0.2])
    module = InMetres(policy.spec, policy.actor, estimate=False)

    def in_torch() -> np.ndarray:
        with torch.inference_mode():
            return module(torch.from_numpy(image), torch.from_numpy(p_WP.astype(np.float32))).numpy()

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "bundle"
        export_policy(policy, folder, limits=default_limits(policy.spec), samples=(image[None], p_WP[None]))
        loading = timing.interleave({"load": timing.Case(lambda: read_bundle(folder))}, LOADS, clock=time.process_time)
        bundle, size = read_bundle(folder), sum(path.stat().st_size for path in folder.iterdir())
    seen = {"image": image, "pusher": np.zeros(2, np.float32)}
    calls: dict[str, Callable[[], object]] = {
        BUNDLE: lambda: bundle.act(image, p_WP),
        MODULE: in_torch,
        PREDICT: lambda: policy.predict(seen),
    }

    def case(call: Callable[[], object]) -> timing.Case:
        return timing.Case(lambda: [call() for _ in range(CALLS)], units=CALLS)

    cases = {name: case(call) for name, call in calls.items()}
    samples = timing.interleave(cases, given.rounds, clock=time.process_time)
    return {
        "reading": loading["load"].summary(1e3),
        "bytes": size,
        "milliseconds": {name: each.summary(1e3) for name, each in samples.items()},
        "ratio": {name: samples[BUNDLE].over(samples[name]) for name in (MODULE, PREDICT)},
    }


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    rows = [
        [name, results.spread(each, 3), results.spread(data["ratio"][name], 2) if name in data["ratio"] else ""]
        for name, each in data["milliseconds"].items()
    ]
    rounds, others = f"{data['rounds']} rounds of {CALLS} calls", f"{data['load']:.0f} %"
    lines = [
        *results.markdown("policy, 64 x 64 px, three images | ms a call | onnxruntime / torch", rows),
        "",
        f"- ms a call in onnxruntime: {results.verdict(data['milliseconds'][BUNDLE]['median'], BAR)}.",
        f"- `read_bundle`, with SHA-256 and golden samples: {results.spread(data['reading'], 0)} ms; the bundle takes "
        f"{data['bytes'] / 1e6:.2f} MB.",
        "",
        f"{rounds} on one CPU; other processes took {others} of the CPUs.",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    results.run("policy", __doc__ or "", measure, table, rounds=30)
