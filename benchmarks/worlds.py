# SPDX-License-Identifier: MIT
"""Timings of the push in 32 worlds on one thread and on two, forward, and forward with backward."""

import argparse
import os

from benchmarks import results, timing

WORLDS, THREADS = 32, 2
if __name__ == "__main__":
    timing.limit_threads(THREADS)  # before numba and torch are imported

import torch

from benchmarks.scenes.pinwm_scene import PinwmPush

BAR = 1.7  # times the speed of one thread
_KINDS = {"forward": "forward", "forward_backward": "forward and backward"}


def measure(given: argparse.Namespace) -> dict:
    """Time one rollout of all worlds with one thread and with two, in turn."""
    if (os.cpu_count() or 1) < THREADS:
        raise SystemExit(f"this machine has one core; a speed-up of {THREADS} threads needs {THREADS}")
    cases = {}
    for count in (1, THREADS):
        scene = PinwmPush("sphere", num_worlds=WORLDS, threads=count)

        def threads_of_torch(count: int = count) -> None:
            torch.set_num_threads(count)

        for name in _KINDS:
            case = getattr(scene, name)()
            cases[f"{name}_{count}"] = timing.Case(case.run, threads_of_torch, case.units)
    samples = timing.interleave(cases, given.rounds)
    data: dict = {"microseconds": {name: sample.summary() for name, sample in samples.items()}}
    for name in _KINDS:
        data[f"{name}_speedup"] = samples[f"{name}_1"].over(samples[f"{name}_{THREADS}"])
    return data


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    rows, verdicts = [], []
    for name, label in _KINDS.items():
        times = [results.spread(data["microseconds"][f"{name}_{count}"]) for count in (1, THREADS)]
        speedup = data[f"{name}_speedup"]
        rows.append([label, *times, results.spread(speedup, 2)])
        verdicts.append(f"- {label}: {results.verdict(speedup['median'], BAR, at_most=False)}.")
    header = "rollout | 1 thread, µs a world-step | 2 threads, µs a world-step | speed-up (quartiles)"
    tail = f"{WORLDS} worlds, {data['rounds']} rounds; other processes took {data['load']:.0f} % of the CPUs."
    return "\n".join([*results.markdown(header, rows), "", *verdicts, "", tail])


if __name__ == "__main__":
    results.run("worlds", __doc__ or "", measure, table, rounds=30)
