"""Peak memory of a rollout, each measured in a process of its own.

A short rollout first loads and compiles everything. The peak of the resident memory is then reset; the figure
is by how much it then exceeds the resident memory before the rollout. Needs Linux (/proc/self).
"""

import json
import subprocess
import sys
from pathlib import Path

from benchmarks import push, results, timing

BAR = 500.0  # MB that a differentiable rollout of 32 worlds may add
_LENGTHS = (1, 4, 16)  # times 320 steps
_WORLDS = 32
_REPEATS = 3
_STATUS = Path("/proc/self/status")


def status(key: str) -> float:
    """A field of /proc/self/status, in MB (1 MB = 10^6 bytes); the kernel's kB are KiB."""
    for line in _STATUS.read_text().splitlines():
        if line.startswith(key + ":"):
            return int(line.split()[1]) * 1024 / 1e6
    raise KeyError(key)


def _child(worlds: int, length: int, gradient: bool) -> dict[str, float]:
    """Runs one rollout in this process and measures what it adds.

    Args:
        worlds: Number of worlds.
        length: Length of the rollout, in units of 320 steps; above 1 only without a gradient.
        gradient: Whether to take the gradient too.

    Returns:
        In MB: resident before, and added at the peak; action: size of the tensor of the pusher's velocities,
        which the caller owns and which exists before the rollout.
    """
    timing.limit_threads(1)
    from benchmarks.pinwm_scene import PinwmPush

    scene = PinwmPush("sphere", num_worlds=worlds)
    case = scene.forward_backward if gradient else scene.forward
    case(push.SUBSTEPS).run()  # compiles and allocates what does not depend on the length
    # To and fro: the pusher returns every other 320 steps, so that it does not leave with the block.
    parts = [scene.V_WP if index % 2 == 0 else -scene.V_WP for index in range(length)]
    scene.V_WP = parts[0] if length == 1 else sum_parts(parts)
    # As many frames from a long rollout as from a short one: the frames are the caller's.
    scene.record_every *= length
    run = case(push.STEPS * length).run
    before = status("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak, VmHWM
    run()
    action = scene.V_WP.numel() * 8 / 1e6
    return {"before": before, "added": status("VmHWM") - before, "action": action}


def sum_parts(parts: list) -> object:
    """The parts one after the other: (length * steps, W, 6)."""
    import torch

    return torch.cat(parts)


def _measure(worlds: int, length: int, gradient: bool) -> dict[str, float]:
    """The median of a few fresh processes."""
    runs = []
    for _ in range(_REPEATS):
        arguments = [str(worlds), str(length), str(int(gradient))]
        command = [sys.executable, "-m", "benchmarks.memory", "--child", *arguments]
        output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        runs.append(json.loads(output.splitlines()[-1]))
    return sorted(runs, key=lambda run: run["added"])[_REPEATS // 2]


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    lines = [
        "| rollout | worlds | steps | resident before, MB | added at the peak, MB |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in data["rows"]:
        kind = "forward and backward" if row["gradient"] else "no gradient"
        lines.append(f"| {kind} | {row['worlds']} | {row['steps']} | {row['before']:.0f} | {row['added']:.1f} |")
    added = [row["added"] for row in data["rows"] if row["gradient"]]
    flat = [row["added"] for row in data["rows"] if not row["gradient"]]
    lines += [
        "",
        f"- No gradient: {max(flat) - min(flat):.1f} MB between the shortest and the longest rollout.",
        f"- Differentiable, {_WORLDS} worlds, {push.STEPS} steps, MB: {results.verdict(max(added), BAR)}.",
    ]
    return "\n".join(lines)


def main() -> None:
    """Measures and reports the figures."""
    parser = results.arguments(__doc__ or "")
    parser.add_argument("--child", nargs=3, type=int, metavar=("WORLDS", "LENGTH", "GRADIENT"))
    given = parser.parse_args()
    if given.child:
        worlds, length, gradient = given.child
        print(json.dumps(_child(worlds, length, bool(gradient))))
        return
    if not _STATUS.exists():
        print("this benchmark reads /proc/self, which only Linux has")
        return
    rows = []
    for worlds, length, gradient in [*((_WORLDS, length, False) for length in _LENGTHS), (_WORLDS, 1, True)]:
        measured = _measure(worlds, length, gradient)
        rows.append({"worlds": worlds, "steps": length * push.STEPS, "gradient": gradient, **measured})
    data = {"rows": rows}
    results.publish("memory", data, table(data), given.write)


if __name__ == "__main__":
    main()
