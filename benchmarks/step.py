# SPDX-License-Identifier: MIT
"""Time of one step on one core: pinwm_drake, forward and with its gradient, beside MuJoCo and Bullet.

All engines perform the push of `push.py` for 320 steps; a round is one rollout of each, in turn.
"""

import time

from benchmarks import results, timing
from benchmarks.scenes import push

if __name__ == "__main__":
    timing.limit_threads(1)  # before numba and torch are imported

import numpy as np

from benchmarks.scenes.bullet_scene import BulletPush
from benchmarks.scenes.mujoco_scene import MujocoPush
from benchmarks.scenes.pinwm_scene import PinwmPush

FORWARD_BAR, BACKWARD_BAR = 2.5, 7.0  # times MuJoCo's step
_OURS = {
    "forward": "forward",
    "forward_backward": "forward and backward",
}


def measure(pusher: str, rounds: int) -> dict:
    """Time the push with one shape of pusher.

    Args:
        pusher: Name of the pusher, one of `push.PUSHERS`.
        rounds: Number of timed rounds.

    Raises:
        RuntimeError: an engine's pusher is not in touch with the block for most of the rollout.
    """
    ours, mujoco, bullet = PinwmPush(pusher), MujocoPush(pusher), BulletPush(pusher)
    samples = timing.interleave(
        {
            "forward": ours.forward(),
            "forward_backward": ours.forward_backward(),
            "mujoco": mujoco.c_loop(),
            "mujoco_python": mujoco.python_loop(),
            "mujoco_calls": mujoco.python_loop(nstep=0),
            "bullet": bullet.loop(),
            "bullet_calls": bullet.call_overhead(),
        },
        rounds,
        clock=time.process_time,
    )
    contacts = {}
    for name, engine in (("pinwm_drake", ours), ("mujoco", mujoco), ("bullet", bullet)):
        trace = engine.trace()
        counts = np.array(trace["contacts"])
        if trace["pusher_steps"] < 0.8 * push.STEPS:
            # Without the pusher it would be another, cheaper scene.
            raise RuntimeError(f"{name}: the {pusher} presses in {trace['pusher_steps']} of {push.STEPS} steps")
        contacts[name] = {
            "mean": round(float(counts.mean()), 2),
            "min": int(counts.min()),
            "max": int(counts.max()),
            "pusher_steps": trace["pusher_steps"],
            "moved_mm": round(float(np.hypot(*trace["p"][:2])) * 1e3, 1),
            "iterations": trace.get("iterations"),
            "residual": trace.get("residual"),
        }
    pairs = [(name, other) for name in _OURS for other in ("mujoco", "bullet")]
    ratios = {f"{name}_over_{other}": samples[name].over(samples[other]) for name, other in pairs}
    times = {name: sample.summary() for name, sample in samples.items()}
    return {"microseconds": times, **ratios, "contacts": contacts}


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    rows: list[list[object]] = []
    verdicts, residuals = [], []
    for pusher, figures in data["pushers"].items():
        times = figures["microseconds"]

        touch = {
            name: [
                f"{count['mean']:.1f} ({count['min']} to {count['max']})",
                f"{count['pusher_steps']} of {push.STEPS}",
                f"{count['moved_mm']:.0f} mm",
            ]
            for name, count in figures["contacts"].items()
        }
        for name, label in _OURS.items():
            ratios = [f"{figures[f'{name}_over_{other}']['median']:.2f}" for other in ("mujoco", "bullet")]
            rows.append([pusher, f"pinwm_drake, {label}", results.spread(times[name]), *ratios, *touch["pinwm_drake"]])
        in_python = times["mujoco_python"]["median"] - times["mujoco_calls"]["median"]
        bare_bullet = times["bullet"]["median"] - times["bullet_calls"]["median"]
        against = f"{times['mujoco']['median'] / times['bullet']['median']:.2f}"
        rows += [
            [pusher, "MuJoCo, loop in C", results.spread(times["mujoco"]), 1, against, *touch["mujoco"]],
            [pusher, "MuJoCo, loop in Python less empty calls", f"{in_python:.1f}", *[""] * 5],
            [pusher, "Bullet, loop in Python", results.spread(times["bullet"]), "", 1, *touch["bullet"]],
            [pusher, "Bullet, less calls in an empty world", f"{bare_bullet:.1f}", *[""] * 5],
        ]
        forward = results.verdict(figures["forward_over_mujoco"]["median"], FORWARD_BAR)
        backward = results.verdict(figures["forward_backward_over_mujoco"]["median"], BACKWARD_BAR)
        verdicts.append(f"- {pusher}: forward / MuJoCo {forward}; forward and backward / MuJoCo {backward}.")
        residuals.append(figures["contacts"]["pinwm_drake"]["residual"])
    tail = (
        f"{data['rounds']} rounds; other processes took {data['load']:.0f} % of the CPUs. Largest residual "
        f"of pinwm_drake's steps there (momentum, signs, complementarity; SI units): {max(residuals):.0e}."
    )
    header = (
        "pusher | engine | µs a step: median (quartiles) | / MuJoCo | / Bullet | contacts: mean (range) "
        "| steps with the pusher | block moved"
    )
    return "\n".join([*results.markdown(header, rows), "", *verdicts, "", tail])


if __name__ == "__main__":
    results.run(
        "step",
        __doc__ or "",
        lambda given: {"pushers": {pusher: measure(pusher, given.rounds) for pusher in given.pushers}},
        table,
        rounds=150,
        options={"--pushers": {"nargs": "+", "choices": push.PUSHERS, "default": list(push.PUSHERS)}},
    )
