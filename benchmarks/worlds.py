"""Timings of the push in 32 worlds on one thread and on two, forward, and forward with backward."""

import os

from benchmarks import results, timing

WORLDS, THREADS = 32, 2
timing.limit_threads(THREADS)  # before numba and torch are imported

import torch

from benchmarks.pinwm_scene import PinwmPush

BAR = 1.7  # times the speed of one thread


def measure(rounds: int) -> dict:
    """Times one rollout of all worlds with one thread and with two, in turn."""
    cases = {}
    for count in (1, THREADS):
        scene = PinwmPush("sphere", num_worlds=WORLDS, threads=count)

        def threads_of_torch(count: int = count) -> None:
            torch.set_num_threads(count)

        for name, case in (("forward", scene.forward()), ("forward_backward", scene.forward_backward())):
            cases[f"{name}_{count}"] = timing.Case(case.run, threads_of_torch, case.units)
    samples = timing.interleave(cases, rounds)
    data: dict = {"microseconds": {name: sample.summary() for name, sample in samples.items()}}
    for name in ("forward", "forward_backward"):
        data[f"{name}_speedup"] = samples[f"{name}_1"].over(samples[f"{name}_{THREADS}"])
    return data


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    lines = [
        "| rollout | 1 thread, µs a world-step | 2 threads, µs a world-step | speed-up (quartiles) |",
        "| --- | --- | --- | --- |",
    ]
    times = data["microseconds"]
    for name, label in (("forward", "forward"), ("forward_backward", "forward and backward")):
        one, two = times[f"{name}_1"], times[f"{name}_{THREADS}"]
        speedup = results.spread(data[f"{name}_speedup"], 2)
        lines.append(f"| {label} | {results.spread(one)} | {results.spread(two)} | {speedup} |")
    verdicts = [
        f"- {label}: {results.verdict(data[f'{name}_speedup']['median'], BAR, at_most=False)}."
        for name, label in (("forward", "forward"), ("forward_backward", "forward and backward"))
    ]
    tail = f"{WORLDS} worlds, {data['rounds']} rounds; other processes took {data['load']:.0f} % of the CPUs."
    return "\n".join([*lines, "", *verdicts, "", tail])


def main() -> None:
    """Measures and reports the figures."""
    parser = results.arguments(__doc__ or "")
    parser.add_argument("--rounds", type=int, default=30)
    given = parser.parse_args()
    if (os.cpu_count() or 1) < THREADS:
        print(f"this machine has one core; a speed-up of {THREADS} threads needs {THREADS}")
        return
    with timing.CompetingLoad() as load:
        measured = measure(given.rounds)
    data = {"rounds": given.rounds, "load": load.percent, **measured}
    results.publish("worlds", data, table(data), given.write)


if __name__ == "__main__":
    main()
