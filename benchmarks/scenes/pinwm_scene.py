# SPDX-License-Identifier: MIT
"""Push in pinwm_drake, in any number of worlds."""

from dataclasses import fields, replace

import numpy as np
import torch

from benchmarks.scenes import push
from benchmarks.timing import Case
from pinwm_drake.geometry import shapes
from pinwm_drake.physics import diagnose
from pinwm_drake.physics.diagnose import StepReport
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State, Trajectory
from pinwm_drake.physics.stepper import Stepper


def block() -> Body:
    """Return the T-block: two boxes, uniform density."""
    upright = np.eye(3)
    boxes = [
        shapes.box(push.BAR_SIZE, (upright, np.array(push.BAR_CENTER))),
        shapes.box(push.STEM_SIZE, (upright, np.array(push.STEM_CENTER))),
    ]
    return Body(name="t_block", pieces=boxes, mass=push.MASS, inertia=np.diag(push.block_inertia()))


def make_model(pusher: str) -> Model:
    """Block, floor and a pusher of the named shape."""
    tip = {
        "sphere": lambda: shapes.sphere(push.RADIUS),
        "capsule": lambda: shapes.capsule(push.RADIUS, push.LENGTH),
        "cylinder": lambda: shapes.cylinder(push.RADIUS, push.LENGTH),
    }[pusher]()
    return Model(bodies=[block()], pusher=[tip], time_step=push.TIME_STEP)


class PinwmPush:
    """A batch of worlds that all perform the push.

    Attributes:
        parameters, state, V_WP: inputs of a rollout; V_WP is (steps, W, 6), the pusher's velocity.
        record_every: steps between recorded poses.
    """

    def __init__(self, pusher: str, num_worlds: int = 1, threads: int = 1) -> None:
        self.model = make_model(pusher)
        self.stepper = Stepper(self.model, num_threads=threads)
        self.parameters = Parameters.nominal(
            self.model,
            friction_floor=push.FRICTION,
            friction_pusher=push.FRICTION,
            restitution_floor=0.0,
            restitution_pusher=0.0,
            num_worlds=num_worlds,
        )
        self.state = State.at_rest(
            self.model, num_worlds, p_WB=(0.0, 0.0, push.BLOCK_HEIGHT), p_WP=push.pusher_start(pusher)
        )
        # Each world has its own offset, so that no two worlds do the same; world 0 has the nominal one.
        self.state.p_WP[:, 0] += torch.linspace(0.0, push.OFFSET, num_worlds)
        self.V_WP = torch.zeros(push.STEPS, num_worlds, 6, dtype=torch.float64)
        self.V_WP[..., 4] = -push.SPEED
        self.record_every = push.SUBSTEPS

    def forward(self, steps: int | None = None) -> Case:
        """Return the rollout without gradients, a record every frame."""

        def run() -> None:
            with torch.no_grad():
                V_WP = self.V_WP[:steps]
                self.stepper.rollout(self.parameters, self.state, V_WP, record_every=self.record_every)

        return Case(run, units=self.V_WP[:steps, :, 0].numel())

    def loss_and_gradient(self, steps: int | None = None) -> list[torch.Tensor]:
        """Gradient of a loss over all recorded poses, in all parameters, the initial state and the action."""
        parameters, state = leaves(self.parameters), leaves(self.state)
        V_WP = self.V_WP[:steps].detach().requires_grad_()
        trajectory = self.stepper.rollout(parameters, state, V_WP, record_every=self.record_every)
        (trajectory.p_WB.square().sum() + trajectory.q_WB[..., 3].sum()).backward()
        inputs = [getattr(record, field.name) for record in (parameters, state) for field in fields(record)]
        return [tensor.grad for tensor in [*inputs, V_WP]]

    def forward_backward(self, steps: int | None = None) -> Case:
        """Return the rollout and the gradient in all of its inputs."""
        return Case(lambda: self.loss_and_gradient(steps), units=self.V_WP[:steps, :, 0].numel())

    def trace(self) -> dict:
        """Roll world 0 out once, untimed, and look into every step.

        Returns:
            contacts: (steps,) number of contacts that press (positive normal impulse); pusher_steps: steps in
            which the pusher presses; iterations: mean number of Newton iterations; residual: largest momentum
            residual, sign violation or complementarity of any step, SI units; p (3,) of the block, world frame, metres.
        """
        with torch.no_grad():
            path = self.stepper.rollout(self.parameters, self.state, self.V_WP)
        reports = inspect_path(self.model, self.parameters, path, self.V_WP)
        pressing = [pressing_pairs(report) for report in reports]
        errors = [(step.momentum_residual, step.sign_violation, step.complementarity) for step in reports]
        return {
            "contacts": [len(pairs) for pairs in pressing],
            "pusher_steps": sum("t_block-pusher" in pairs for pairs in pressing),
            "iterations": float(np.mean([report.iterations for report in reports])),
            "residual": max(max(error) for error in errors),
            "p": path.p_WB[-1, 0, 0].tolist(),
        }


def inspect_path(model: Model, theta: Parameters, path: Trajectory, V_WP: torch.Tensor) -> list[StepReport]:
    """Return the contacts and the solution of every step of world 0.

    Args:
        model: the scene.
        theta: its parameters.
        path: frames of a rollout with record_every=1.
        V_WP: (T, W, 6), the pusher's velocity in it.
    """
    steps = enumerate(V_WP)
    return [diagnose.inspect(model, theta, path.frame(step), velocity) for step, velocity in steps]


def pressing_pairs(report: StepReport) -> list[str]:
    """Return the pair of each contact that presses, that is, has a positive normal impulse."""
    return [pair for pair, impulse in zip(report.pair, report.impulse[:, 0], strict=True) if impulse > 0.0]


def leaves(record: Parameters | State) -> Parameters | State:
    """Return a copy whose tensors each collect a gradient."""
    tensors = {field.name: getattr(record, field.name) for field in fields(record)}
    return replace(record, **{name: tensor.detach().clone().requires_grad_() for name, tensor in tensors.items()})
