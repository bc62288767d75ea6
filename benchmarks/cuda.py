"""Timings of the torch path on CUDA with 4,096 worlds, beside the same path and the numba kernels on the CPU."""

import torch

from benchmarks import push, results, timing
from benchmarks.pinwm_scene import PinwmPush

_GPU_WORLDS = 4096
_CPU_WORLDS = 64  # of the torch path: thousands would take minutes, and its cost a world is flat by then
_STEPS = 2 * push.SUBSTEPS


def _synchronised(case: timing.Case) -> timing.Case:
    """Case that is timed until the device has finished."""

    def run() -> None:
        case.run()
        torch.cuda.synchronize()

    return timing.Case(run, case.prepare, case.units)


def measure(rounds: int) -> dict:
    """Times a short push on both devices and compares where the block ends.

    Returns:
        microseconds: median and quartiles per world-step; pose_difference: largest difference of the final
        block position between CUDA and the numba kernels on the CPU, in metres, over all worlds.
    """
    gpu = PinwmPush("sphere", _GPU_WORLDS, backend="torch", device="cuda")
    cpu = PinwmPush("sphere", _CPU_WORLDS, backend="torch")
    kernels = PinwmPush("sphere", _GPU_WORLDS)
    samples = {}
    for name, scene, wrap in (
        ("CUDA, torch", gpu, _synchronised),
        ("CPU, torch", cpu, lambda case: case),
        ("CPU, numba", kernels, lambda case: case),
    ):
        cases = {"forward": wrap(scene.forward(_STEPS)), "backward": wrap(scene.forward_backward(_STEPS))}
        for kind, sample in timing.interleave(cases, rounds, warmup=1).items():
            samples[f"{name}|{kind}"] = sample
    with torch.no_grad():
        ends = [
            scene.stepper.rollout(
                scene.parameters, scene.state, scene.V_WP[:_STEPS], record_every=push.SUBSTEPS
            ).p_WB[-1].cpu()
            for scene in (gpu, kernels)
        ]  # fmt: skip
    return {
        "microseconds": {name: sample.summary() for name, sample in samples.items()},
        "pose_difference": float((ends[0] - ends[1]).abs().max()),
    }


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    lines = [
        "| path | worlds | forward, µs a world-step | forward and backward, µs a world-step |",
        "| --- | --- | --- | --- |",
    ]
    times = data["microseconds"]
    for name in dict.fromkeys(key.split("|")[0] for key in times):
        worlds = _CPU_WORLDS if name == "CPU, torch" else _GPU_WORLDS
        forward, backward = (results.spread(times[f"{name}|{kind}"], 2) for kind in ("forward", "backward"))
        lines.append(f"| {name} | {worlds} | {forward} | {backward} |")
    return "\n".join(
        [
            *lines,
            "",
            f"{data['device']}; {_STEPS} steps, {data['rounds']} rounds; the final positions on CUDA and on "
            f"the CPU differ by at most {data['pose_difference']:.1e} m.",
        ]
    )


def main() -> None:
    """Measures and reports; says so and stops where there is no CUDA device."""
    parser = results.arguments(__doc__ or "")
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    if not torch.cuda.is_available():
        print("no CUDA device")
        return
    measured = measure(given.rounds)
    data = {"rounds": given.rounds, "device": torch.cuda.get_device_name(), **measured}
    results.publish("cuda", data, table(data), given.write)


if __name__ == "__main__":
    main()
