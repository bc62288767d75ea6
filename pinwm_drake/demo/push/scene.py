"""The demonstration push: a T-block, a floor, a pusher on a straight line, and derivatives of the outcome."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
import torch

from pinwm_drake.demo.push.options import PushOptions
from pinwm_drake.geometry.convex import t_block
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.geometry.pieces import ConvexPiece
from pinwm_drake.geometry.shapes import capsule, cylinder, sphere
from pinwm_drake.models import model_path
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State, Trajectory
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
    """Derivative of the final yaw with respect to one input.

    Attributes:
        name: The input, in words.
        unit: Unit of the derivative.
        adjoint: From the backward pass through the rollout.
        difference: From central differences of the rollout.
    """

    name: str
    unit: str
    adjoint: float
    difference: float


@dataclass(frozen=True)
class PushResult:
    """The recorded push of N states, in the world frame.

    Attributes:
        times: (N,) [s].
        q_WB: (N, 4), wxyz, orientation of the block.
        p_WB: (N, 3) [m], its centre of mass.
        V_WB: (N, 6) [rad/s; m/s], its spatial velocity at the centre of mass.
        p_WP: (N, 3) [m], centre of the pusher.
        derivatives: Of the final yaw.
    """

    times: np.ndarray
    q_WB: np.ndarray
    p_WB: np.ndarray
    V_WB: np.ndarray
    p_WP: np.ndarray
    derivatives: tuple[Derivative, ...]

    @property
    def R_WB(self) -> np.ndarray:
        """Orientations (N, 3, 3) of the block."""
        return quaternion_to_matrix(torch.from_numpy(self.q_WB)).numpy()

    @property
    def yaw(self) -> np.ndarray:
        """Yaw (N,) [rad] of the block about the vertical since the start, without jumps."""
        return np.unwrap(yaw_of(torch.from_numpy(self.q_WB)).numpy())


def yaw_of(q_WB: torch.Tensor) -> torch.Tensor:
    """The angle from the world's x axis to the body's, seen from above.

    Args:
        q_WB: (..., 4), wxyz, unit norm.

    Returns:
        yaw: (...) [rad], in (-π, π].
    """
    R_WB = quaternion_to_matrix(q_WB)
    return torch.atan2(R_WB[..., 1, 0], R_WB[..., 0, 0])


def pusher_piece(shape: str) -> ConvexPiece:
    """The pusher of that name, upright, centred in its frame."""
    if shape == "sphere":
        return sphere(PUSHER_RADIUS)
    return {"capsule": capsule, "cylinder": cylinder}[shape](PUSHER_RADIUS, PUSHER_LENGTH)


def make_model(options: PushOptions) -> Model:
    """The block on the floor, and the pusher.

    Args:
        options: Time step and pusher are taken from here.

    Returns:
        The model.

    Raises:
        PinwmError: When the block's mesh cannot be used.
    """
    properties = mass_properties(load_mesh(model_path(BLOCK_MESH)), mass=BLOCK_MASS)
    block = Body(name="t_block", pieces=t_block(), mass=BLOCK_MASS, inertia=properties.inertia)
    return Model(bodies=[block], pusher=[pusher_piece(options.pusher)], time_step=options.time_step)


class PushRollout:
    """The push as a differentiable function of frictions and offset."""

    def __init__(self, options: PushOptions) -> None:
        """Builds the model."""
        self.options = options
        self.model = make_model(options)
        self.stepper = Stepper(self.model)

    def run(self, inputs: torch.Tensor, report: Callable[[float], None]) -> Trajectory:
        """Rolls out W worlds.

        Args:
            inputs: (W, 3): friction of block and floor, of block and pusher, offset of the pusher [m].
            report: Called with the share of the work that is done.

        Returns:
            N recorded frames.

        Raises:
            PinwmError: When a parameter is refused or the solver fails.
        """
        options, worlds = self.options, len(inputs)
        parameters = Parameters.nominal(self.model, num_worlds=worlds)
        parameters = replace(parameters, friction=inputs[:, :2])
        state = self._start(inputs[:, 2])
        every = options.steps_per_record
        V_WP = torch.zeros(options.records * every, worlds, 6, dtype=torch.float64)
        V_WP[: round(_MOVING_SHARE * len(V_WP)), :, 4] = options.speed
        chunks = []
        for first in range(0, options.records, _CHUNK):
            last = min(first + _CHUNK, options.records)
            action = V_WP[first * every : last * every]
            chunks.append(self.stepper.rollout(parameters, state, action, record_every=every))
            state = chunks[-1].frame(-1)
            report(last / options.records)
        return _join(chunks)

    def _start(self, offset: torch.Tensor) -> State:
        """The block at rest and the pusher before it, at x = offset (W,) [m]."""
        y = torch.full_like(offset, _BLOCK_NEAR_FACE - PUSHER_RADIUS - _FIRST_GAP)
        p_WP = torch.stack((offset, y, torch.full_like(offset, PUSHER_HEIGHT)), dim=-1)
        return State.at_rest(self.model, len(offset), p_WB=(0.0, 0.0, BLOCK_HEIGHT), p_WP=p_WP)


def _join(chunks: list[Trajectory]) -> Trajectory:
    """Trajectories end to end; each starts where the one before it ends."""

    def joined(name: str) -> torch.Tensor:
        first, *rest = (getattr(chunk, name) for chunk in chunks)
        return torch.cat((first, *(part[1:] for part in rest)))

    return Trajectory(*(joined(part.name) for part in fields(State)))


def simulate_push(options: PushOptions, report: Callable[[str, float], None]) -> PushResult:
    """Simulates the push, differentiates its final yaw, and checks that against central differences.

    Args:
        options: The push.
        report: Called with a stage ("simulate", "differentiate", "check") and the share of it that is done.

    Returns:
        The recorded push.

    Raises:
        PinwmError: When a parameter is refused or the solver fails.
    """
    report("simulate", 0.0)
    rollout = PushRollout(options)
    values = (options.friction, options.pusher_friction, options.offset)
    inputs = torch.tensor(values, dtype=torch.float64, requires_grad=True)
    record = rollout.run(inputs[None], lambda share: report("simulate", share))
    report("differentiate", 0.0)
    (gradient,) = torch.autograd.grad(yaw_of(record.q_WB[-1, 0, 0]), inputs)
    report("differentiate", 1.0)
    differences = _central_differences(rollout, inputs.detach(), lambda share: report("check", share))
    names = ("friction on the floor", "friction at the pusher", "offset of the pusher")
    units = ("rad", "rad", "rad/m")
    derivatives = zip(names, units, gradient.tolist(), differences.tolist(), strict=True)
    q_WB, p_WB, V_WB = (part.detach()[:, 0, 0].numpy() for part in (record.q_WB, record.p_WB, record.V_WB))
    return PushResult(
        times=np.arange(len(q_WB)) * options.time_step * options.steps_per_record,
        q_WB=q_WB,
        p_WB=p_WB,
        V_WB=V_WB,
        p_WP=record.p_WP.detach()[:, 0].numpy(),
        derivatives=tuple(Derivative(*row) for row in derivatives),
    )


@torch.no_grad()
def _central_differences(rollout: PushRollout, inputs: torch.Tensor, report: Callable[[float], None]) -> torch.Tensor:
    """D yaw / d inputs (3,) from six worlds, each with one input moved up or down."""
    steps = _DIFFERENCE_STEP * torch.eye(3, dtype=torch.float64)
    moved = torch.cat((inputs + steps, inputs - steps))
    # A coefficient of 0 cannot be lowered: its difference is one-sided.
    moved[:, :2].clamp_(min=0.0)
    yaw = yaw_of(rollout.run(moved, report).q_WB[-1, :, 0])
    return (yaw[:3] - yaw[3:]) / (moved[:3] - moved[3:]).diagonal()
