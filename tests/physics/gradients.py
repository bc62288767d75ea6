# SPDX-License-Identifier: MIT
"""The one gradient checker of the physics tests."""

import torch

from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State


def flatten(parameters, state, V_WP):
    names = [*parameters.__dataclass_fields__, *state.__dataclass_fields__]
    values = [getattr(parameters, n) for n in parameters.__dataclass_fields__]
    values += [getattr(state, n) for n in state.__dataclass_fields__]
    return dict(zip([*names, "V_WP"], [*values, V_WP], strict=True))


def rollout_frames(stepper, inputs, record_every):
    """A rollout from flat inputs; quaternions and inertia are kept admissible."""
    unit = {n: inputs[n] / inputs[n].norm(dim=-1, keepdim=True) for n in ("q_WB", "q_WP")}
    inertia = 0.5 * (inputs["inertia"] + inputs["inertia"].mT)
    return stepper.rollout(
        Parameters(**{n: inertia if n == "inertia" else inputs[n] for n in Parameters.__dataclass_fields__}),
        State(unit["q_WB"], inputs["p_WB"], inputs["V_WB"], unit["q_WP"], inputs["p_WP"]),
        inputs["V_WP"],
        record_every=record_every,
    )


def functional(frames, cotangents):
    """A fixed linear functional of all recorded frames."""
    return sum((cotangents[n] * getattr(frames, n)).sum() for n in cotangents)


def make_cotangents(inputs, frames, generator):
    return {
        n: torch.randn(frames, *inputs[n].shape, dtype=torch.float64, generator=generator)
        for n in ("q_WB", "p_WB", "V_WB", "q_WP", "p_WP")
    }


def gradients(stepper, inputs, cotangents, record_every):
    """Recorded frames of a rollout, and the gradients of their functional by input."""
    leaves = {n: value.clone().requires_grad_() for n, value in inputs.items()}
    frames = rollout_frames(stepper, leaves, record_every)
    functional(frames, cotangents).backward()
    zero = {n: torch.zeros_like(value) for n, value in inputs.items()}
    return frames, {n: zero[n] if leaf.grad is None else leaf.grad for n, leaf in leaves.items()}


def central_difference(stepper, inputs, cotangents, record_every, name, direction, step):
    """Directional derivative by Richardson-extrapolated central differences: error O(step^4)."""

    def at(scale):
        moved = {**inputs, name: inputs[name] + scale * step * direction}
        with torch.no_grad():
            return float(functional(rollout_frames(stepper, moved, record_every), cotangents))

    near, far = (at(1.0) - at(-1.0)) / (2.0 * step), (at(2.0) - at(-2.0)) / (4.0 * step)
    return (4.0 * near - far) / 3.0
