# SPDX-License-Identifier: MIT
"""Long work in one process: memory, threads and open files stay flat.

Each kind of work runs in a process of its own, which notes its resident memory, threads and open files at 60 moments.
The first quarter is warm-up. Memory is flat where a straight line through the rest, fitted by least squares, rises by
no more than 2 % of the memory at its beginning, or 8 MB; threads and open files are flat where the last quarter has no
more of them than the second. `number` is that of environment steps; the other kinds are in proportion:
10^7 steps go with 10^4 forward passes, 24 simulated hours of control and 100 trainings.
"""

import contextlib
import gc
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil

FULL = 10**7  # environment steps
MOMENTS, WARM_UP = 60, 0.25
_SHARE, _BYTES = 0.02, 8 * 2**20
_WORLDS = 16
Work = Callable[[int, int], Iterator[int]]


def steps(size: int, seed: int) -> Iterator[int]:
    """Steps of 16 worlds of the twin by random actions, with the episodes that end and begin."""
    from pinwm_drake.systems.envs.vector import TaskVectorEnv

    env = TaskVectorEnv("push_t", _WORLDS)
    env.action_space.seed(seed)
    env.reset(seed=seed)
    for number in range(0, size, _WORLDS):
        env.step(env.action_space.sample())
        yield number + _WORLDS


def drake_steps(size: int, seed: int) -> Iterator[int]:
    """Steps of an environment of Drake's hydroelastic engine, 50 an episode."""
    from pinwm_drake.systems.envs.env import TaskEnv

    env = TaskEnv("push_t", "hydroelastic", max_steps=50)
    env.action_space.seed(seed)
    env.reset(seed=seed)
    for number in range(size):
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
        yield number + 1


def forwards(size: int, seed: int) -> Iterator[int]:
    """Forward passes of identification with gradients: physics, rendering and loss of a push."""
    import torch

    from pinwm_drake.capture.episodes import read_episode
    from pinwm_drake.capture.scene import load_capture
    from pinwm_drake.identification.image_loss import BLOCKS
    from tests.identification.samples import write_capture
    from tests.identification.test_identify import problem_of

    with tempfile.TemporaryDirectory() as folder:
        capture = load_capture(write_capture(Path(folder) / "capture"))
        problem = problem_of((capture, read_episode(capture, "0000")), together=True)
    generator = torch.Generator().manual_seed(seed)
    for number in range(size):
        z = 0.3 * torch.randn(2, len(problem.coordinates), generator=generator, dtype=torch.float64)
        problem.frame_losses(z.requires_grad_(), BLOCKS)[0].mean().backward()
        yield number + 1


def control(size: int, seed: int) -> Iterator[int]:
    """Seconds of simulated control of the twin by the bundle that ships, a run of 20 s after the other."""
    from pinwm_drake.learning.bundle import read_bundle
    from pinwm_drake.systems.control.loop import ControlLoop
    from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
    from pinwm_drake.systems.envs.policy_scene import usual_scene
    from pinwm_drake.systems.scenario.load import load_setup

    bundle = read_bundle("push_t")
    options = EnvOptions(image_size=bundle.spec.camera.width)
    setup = environment_setup(load_setup(usual_scene(bundle.spec)), options)
    loop, rng, done = ControlLoop(bundle, bundle.limits, setup, "twin", armed=True), np.random.default_rng(seed), 0.0
    while done < size:
        loop.begin(loop.draw_place(rng))
        loop.listen()
        for row in loop.advance(20.0):
            last = row.t
        loop.stop()
        done += max(last, 0.1)
        yield min(int(done), size)


def trainings(size: int, seed: int) -> Iterator[int]:
    """Trainings that are begun, and interrupted at a random step of theirs, as in a notebook."""
    from pinwm_drake.experiments.requests.train import TrainRequest
    from pinwm_drake.experiments.training import train

    class Stopped(Exception):
        pass

    rng = np.random.default_rng(seed)
    for number in range(size):
        left = int(rng.integers(1, 6))

        def report(step: Any) -> None:
            nonlocal left
            left -= 1
            if not left:
                raise Stopped

        with tempfile.TemporaryDirectory() as folder:
            request = TrainRequest("push_t", Path(folder), method="state", worlds=4, image_size=32, threads=1)
            with contextlib.suppress(Stopped):
                train(replace(request, steps=4096, round_steps=256), report=report)
        yield number + 1


WORKS: dict[str, tuple[Work, int, str]] = {
    "steps": (steps, FULL, "environment steps, 16 worlds of a twin"),
    "drake_steps": (drake_steps, FULL // 100, "environment steps, hydroelastic"),
    "forwards": (forwards, 10**4, "forward and backward passes of identification"),
    "control": (control, 24 * 3600, "simulated seconds of control"),
    "trainings": (trainings, 100, "trainings begun and interrupted"),
}
"""Kinds of work, each with its full size and its words."""


def size_of(kind: str, number: int) -> int:
    """Size of a kind of work that goes with a number of environment steps; 12 at least."""
    return max(WORKS[kind][1] * number // FULL, 12)


def watch(kind: str, size: int, seed: int) -> Iterator[dict[str, float]]:
    """Do the work; what the process takes at moments that are evenly spread, by the work done."""
    process, due, begun = psutil.Process(), 0.0, time.monotonic()
    for done in WORKS[kind][0](size, seed):
        if done >= due or done == size:
            gc.collect()
            yield {
                "done": done,
                "memory": process.memory_info().rss,
                "threads": process.num_threads(),
                "files": process.num_fds(),
                "seconds": round(time.monotonic() - begun, 1),
            }
            due = done + size / MOMENTS


def judged(rows: list[dict[str, float]]) -> dict[str, Any]:
    """Growth after the warm-up, and what was not flat.

    Args:
        rows: What `watch` gave.

    Returns:
        `memory` [byte] after the warm-up, `growth` [byte] by a straight line from there to the end, `threads` and
        `files` that came in addition, and `wrong` in words, "" where all is flat.
    """
    start = round(WARM_UP * len(rows))
    kept = rows[start:]
    done, memory = (np.array([row[name] for row in kept], float) for name in ("done", "memory"))
    growth = float(np.polyfit(done, memory, 1)[0] * (done[-1] - done[0]))
    second, last = rows[start : 2 * start], rows[-start:]
    more = {name: max(row[name] for row in last) - max(row[name] for row in second) for name in ("threads", "files")}
    wrong = [f"{name} grew by {number}" for name, number in more.items() if number > 0]
    if growth > max(_SHARE * memory[0], _BYTES):
        wrong.append(f"memory grew by {growth / 2**20:.1f} MB of {memory[0] / 2**20:.0f} MB")
    return {"memory": int(memory[0]), "growth": round(growth), **more, "wrong": "; ".join(wrong)}


def run(out: Path, number: int, seed: int, kinds: tuple[str, ...] = tuple(WORKS)) -> dict[str, Any]:
    """Do each kind of work; one that is done, in a file of `out`, is not done again.

    See `parts.Part.run`.
    """
    found = {}
    for kind in kinds:
        size = size_of(kind, number)
        file = out / f"{kind}-{size}-{seed}.json"
        if not file.exists():
            command = [sys.executable, "-m", "benchmarks.hardening.endurance", kind, str(size), str(seed)]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=_environment())
            file.write_text(json.dumps([json.loads(line) for line in done.stdout.splitlines()]))
        rows = json.loads(file.read_text())
        found[kind] = {"size": size, "full": WORKS[kind][1], "seconds": rows[-1]["seconds"], **judged(rows)}
    wrong = [{"kind": kind, "wrong": one["wrong"]} for kind, one in found.items() if one["wrong"]]
    return {"number": number, "kinds": found, "violations": wrong}


def _environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def table(found: dict[str, Any]) -> str:
    """Figures as a table in Markdown."""
    rows = ["| work | done | full size | memory, MB | growth, MB | more threads | more files |", "|" + " --- |" * 7]
    for kind, one in found["kinds"].items():
        amounts = f"{one['size']:,} | {one['full']:,} | {one['memory'] / 2**20:.0f} | {one['growth'] / 2**20:+.1f}"
        rows.append(f"| {WORKS[kind][2]} | {amounts} | {one['threads']} | {one['files']} |")
    return "\n".join(rows)


def main() -> None:
    """Do one kind of work, and print what it takes; called by `run` in a process of its own."""
    out, sys.stdout = sys.stdout, sys.stderr
    for row in watch(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])):
        print(json.dumps(row), file=out, flush=True)


if __name__ == "__main__":
    main()
