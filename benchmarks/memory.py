# SPDX-License-Identifier: MIT
"""Peak memory of a rollout, each measured in a process of its own.

A short rollout first loads and compiles everything. The peak of the resident memory is then reset; the figure
is by how much it then exceeds the resident memory before the rollout. Needs Linux (/proc/self).
"""

import argparse
import statistics
from collections.abc import Callable
from pathlib import Path

from benchmarks import results, timing
from benchmarks.scenes import push

BAR = 500.0  # MB that a differentiable rollout of 32 worlds may add
_LENGTHS = (1, 4, 16)  # times 320 steps
_WORLDS = 32
_REPEATS = 3
_STATUS = Path("/proc/self/status")


def status(key: str) -> float:
    """Return a field of /proc/self/status, in MB (1 MB = 10^6 bytes); the kernel's kB are KiB."""
    for line in _STATUS.read_text().splitlines():
        if line.startswith(key + ":"):
            return int(line.split()[1]) * 1024 / 1e6
    raise KeyError(key)


def added(run: Callable[[], object]) -> tuple[float, float]:
    """Memory [MB] of this process before a call, and by how much the call exceeds it at its peak."""
    before = status("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak, VmHWM
    run()
    return before, max(status("VmHWM") - before, 0.0)


def _rollout(length: int, gradient: bool) -> tuple[float, float]:
    """Return the memory [MB] of one rollout of `length` times 320 steps, above 1 only without a gradient."""
    timing.limit_threads(1)
    import torch

    from benchmarks.scenes.pinwm_scene import PinwmPush

    scene = PinwmPush("sphere", num_worlds=_WORLDS)
    case = scene.forward_backward if gradient else scene.forward
    case(push.SUBSTEPS).run()  # compiles and allocates what does not depend on the length
    # To and fro: the pusher returns every other 320 steps, so that it does not leave with the block.
    scene.V_WP = torch.cat([scene.V_WP if index % 2 == 0 else -scene.V_WP for index in range(length)])
    # As many frames from a long rollout as from a short one: the frames are the caller's.
    scene.record_every *= length
    return added(case(push.STEPS * length).run)


def measure(_: argparse.Namespace) -> dict:
    """Measures all rollouts, the median of a few fresh processes each."""
    if not _STATUS.exists():
        raise SystemExit("this benchmark reads /proc/self, which only Linux has")
    rows = []
    for length, gradient in [*((length, False) for length in _LENGTHS), (1, True)]:
        before, more = zip(*(timing.alone(_rollout, length, gradient) for _ in range(_REPEATS)), strict=True)
        figures = {"before": statistics.median(before), "added": statistics.median(more)}
        rows.append({"worlds": _WORLDS, "steps": length * push.STEPS, "gradient": gradient, **figures})
    return {"rows": rows}


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    added = {kind: [row["added"] for row in data["rows"] if row["gradient"] == kind] for kind in (False, True)}
    rows = [
        (
            "forward and backward" if row["gradient"] else "no gradient",
            row["worlds"],
            row["steps"],
            f"{row['before']:.0f}",
            f"{row['added']:.1f}",
        )
        for row in data["rows"]
    ]
    flat = max(added[False]) - min(added[False])
    lines = [
        *results.markdown("rollout | worlds | steps | resident before, MB | added at the peak, MB", rows),
        "",
        f"- No gradient: {flat:.1f} MB between the shortest and the longest rollout.",
        f"- Differentiable, {_WORLDS} worlds, {push.STEPS} steps, MB: {results.verdict(max(added[True]), BAR)}.",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    results.run("memory", __doc__ or "", measure, table)
