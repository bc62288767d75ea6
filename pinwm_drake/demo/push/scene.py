# SPDX-License-Identifier: MIT
"""The demonstration push: a T-block, a floor, a pusher on a straight line, and derivatives of the outcome."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import torch

from pinwm_drake.demo.push.options import PushOptions
from pinwm_drake.geometry.convex import t_block
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.geometry.shapes import capsule, cylinder, sphere
from pinwm_drake.models import model_path
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.spatial.rotations import quaternion_to_matrix

BLOCK_MASS = 1.0  # [kg]
BLOCK_HEIGHT = 0.025  # of its centre of mass, lying on the floor [m]
BLOCK_MESH = "t_block/t_block.obj"
PUSHER_RADIUS = 0.010  # [m]
PUSHER_LENGTH = 0.030  # of a capsule's or cylinder's straight part [m]
PUSHER_HEIGHT = 0.030  # of its centre [m]
_BLOCK_NEAR_FACE = -0.055  # y of the face that is pushed [m]
_FIRST_GAP = 0.005  # between that face and the pusher at the start [m]
_MOVING_SHARE = 2 / 3  # of the time, after which the pusher stands still
_CHUNK = 15  # recorded states between two reports of progress
# For each derivative the input is moved by this much either way: more would cross kinks (a step in which the pusher
# touches first, a contact that changes its friction direction), less would drown in rounding, 1e-10 / step.
_DIFFERENCE_STEP = 1e-5


@dataclass(frozen=True)
class Derivative:
    """Derivative of the final yaw with respect to one input."""

    name: str  # of the input, in words
    unit: str
    adjoint: float  # from the backward pass through the rollout
    difference: float  # from central differences of the rollout


@dataclass(frozen=True)
class PushRecord:
    """The recorded push of N states, in the world frame."""

    times: np.ndarray  # (N,) [s]
    q_WB: np.ndarray  # (N, 4), wxyz, orientation of the block
    p_WB: np.ndarray  # (N, 3) [m], its centre of mass
    V_WB: np.ndarray  # (N, 6) [rad/s; m/s], its spatial velocity at the centre of mass
    p_WP: np.ndarray  # (N, 3) [m], centre of the pusher
    derivatives: tuple[Derivative, ...]

    @property
    def R_WB(self) -> np.ndarray:
        """Orientations (N, 3, 3) of the block."""
        return quaternion_to_matrix(torch.from_numpy(self.q_WB)).numpy()

    @property
    def yaw(self) -> np.ndarray:
        """Yaw (N,) [rad] of the block about the vertical since the start, without jumps."""
        return np.unwrap(_yaw(torch.from_numpy(self.q_WB)).numpy())

    @property
    def speed(self) -> np.ndarray:
        """Speed (N,) [m/s] of the block's centre of mass."""
        return np.linalg.norm(self.V_WB[:, 3:], axis=1)


def simulate_push(options: PushOptions, report: Callable[[str, float], None]) -> PushRecord:
    """Simulate the push, differentiate its final yaw, and check that against central differences.

    Args:
        options: The push.
        report: Called with a stage ("simulate", "differentiate", "check") and the share of it that is done.

    Raises:
        PinwmError: When a parameter is refused or the solver fails.
    """
    report("simulate", 0.0)
    stepper = Stepper(_model(options))
    values = (options.friction, options.pusher_friction, options.offset)
    inputs = torch.tensor(values, dtype=torch.float64, requires_grad=True)
    record = _roll_out(stepper, options, inputs[None], lambda share: report("simulate", share))
    report("differentiate", 0.0)
    (gradient,) = torch.autograd.grad(_yaw(record["q_WB"][-1, 0, 0]), inputs)
    report("differentiate", 1.0)
    # Six worlds, each with one input moved up or down. A coefficient of 0 cannot be lowered: its difference is
    # one-sided.
    steps = _DIFFERENCE_STEP * torch.eye(3, dtype=torch.float64)
    moved = torch.cat((inputs.detach() + steps, inputs.detach() - steps))
    moved[:, :2].clamp_(min=0.0)
    with torch.no_grad():
        yaw = _yaw(_roll_out(stepper, options, moved, lambda share: report("check", share))["q_WB"][-1, :, 0])
    differences = (yaw[:3] - yaw[3:]) / (moved[:3] - moved[3:]).diagonal()
    names = ("friction on the floor", "friction at the pusher", "offset of the pusher")
    derivatives = zip(names, ("rad", "rad", "rad/m"), gradient.tolist(), differences.tolist(), strict=True)
    return PushRecord(
        times=np.arange(len(record["p_WP"])) * options.time_step * options.steps_per_record,
        **{name: record[name].detach()[:, 0, 0].numpy() for name in ("q_WB", "p_WB", "V_WB")},
        p_WP=record["p_WP"].detach()[:, 0].numpy(),
        derivatives=tuple(Derivative(*row) for row in derivatives),
    )


def _model(options: PushOptions) -> Model:
    properties = mass_properties(load_mesh(model_path(BLOCK_MESH)), mass=BLOCK_MASS)
    block = Body(name="t_block", pieces=t_block(), mass=BLOCK_MASS, inertia=properties.inertia)
    pusher = {
        "sphere": lambda: sphere(PUSHER_RADIUS),
        "capsule": lambda: capsule(PUSHER_RADIUS, PUSHER_LENGTH),
        "cylinder": lambda: cylinder(PUSHER_RADIUS, PUSHER_LENGTH),
    }[options.pusher]()
    return Model(bodies=[block], pusher=[pusher], time_step=options.time_step)


def _roll_out(
    stepper: Stepper, options: PushOptions, inputs: torch.Tensor, report: Callable[[float], None]
) -> dict[str, torch.Tensor]:
    """Roll out W worlds, differentiably: the fields of the states, each with a leading axis of N recorded frames.

    The inputs (W, 3) are the friction of block and floor, of block and pusher, and the offset of the pusher [m].
    """
    model, worlds, every = stepper.model, len(inputs), options.steps_per_record
    parameters = replace(Parameters.nominal(model, num_worlds=worlds), friction=inputs[:, :2])
    place = (_BLOCK_NEAR_FACE - PUSHER_RADIUS - _FIRST_GAP, PUSHER_HEIGHT)
    p_WP = torch.cat((inputs[:, 2:], torch.tensor(place, dtype=torch.float64).expand(worlds, 2)), dim=1)
    state = State.at_rest(model, worlds, p_WB=(0.0, 0.0, BLOCK_HEIGHT), p_WP=p_WP)
    V_WP = torch.zeros(options.records * every, worlds, 6, dtype=torch.float64)
    V_WP[: round(_MOVING_SHARE * len(V_WP)), :, 4] = options.speed
    names = [item.name for item in fields(State)]
    frames = {name: [getattr(state, name)[None]] for name in names}
    for first in range(0, options.records, _CHUNK):
        last = min(first + _CHUNK, options.records)
        chunk = stepper.rollout(parameters, state, V_WP[first * every : last * every], record_every=every)
        for name in names:
            frames[name].append(getattr(chunk, name)[1:])
        state = chunk.frame(-1)
        report(last / options.records)
    return {name: torch.cat(parts) for name, parts in frames.items()}


def _yaw(q_WB: torch.Tensor) -> torch.Tensor:
    """Return the angle (...) [rad] from the world's x axis to the body's, seen from above, for q_WB (..., 4)."""
    R_WB = quaternion_to_matrix(q_WB)
    return torch.atan2(R_WB[..., 1, 0], R_WB[..., 0, 0])
