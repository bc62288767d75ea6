# SPDX-License-Identifier: MIT
"""State, which changes in a rollout: poses and velocities of all worlds."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Self

import torch
from torch import Tensor

from pinwm_drake.errors import StateError
from pinwm_drake.physics.model import Model

# What no scene on a table has: an error of units is likelier.
MOST_SPEED = 1e3  # m/s or rad/s
_LIMITS = {"p_WB": 1e3, "V_WB": MOST_SPEED, "p_WP": 1e3}  # m


class TensorFields:
    """Base of dataclasses whose fields are tensors."""

    def tensors(self) -> tuple[Tensor, ...]:
        """Fields in their order, the form in which the kernels take them."""
        return tuple(getattr(self, item.name) for item in fields(self))  # type: ignore[arg-type]  # a dataclass

    def changed(self, change: Callable[[Tensor], Tensor]) -> Self:
        """Copy whose tensors went through a function."""
        return type(self)(*map(change, self.tensors()))

    def worlds(self, numbers: Tensor) -> Self:
        """Those of some worlds, given by their numbers (n,)."""
        return self.changed(lambda tensor: tensor[numbers])

    def detach(self) -> Self:
        """Copy with the same numbers, cut from the graph that autograd keeps."""
        return self.changed(Tensor.detach)

    def to(self, device: torch.device | str) -> Self:
        """Copy on another device."""
        return self.changed(lambda tensor: tensor.to(device))


@dataclass(frozen=True, eq=False)
class State(TensorFields):
    """State of W worlds; all float64, one device.

    Attributes:
        q_WB: (W, nb, 4), orientations of the bodies, unit quaternions (w, x, y, z).
        p_WB: (W, nb, 3), positions of their centres of mass, m, world frame.
        V_WB: (W, nb, 6), their spatial velocities [rad/s; m/s], world frame, at the centre of mass.
        q_WP: (W, 4), orientation of the pusher; ignored without one.
        p_WP: (W, 3), its position, m.
    """

    q_WB: Tensor
    p_WB: Tensor
    V_WB: Tensor
    q_WP: Tensor
    p_WP: Tensor

    @staticmethod
    def at_rest(
        model: Model,
        num_worlds: int = 1,
        *,
        q_WB: object = (1.0, 0.0, 0.0, 0.0),
        p_WB: object = (0.0, 0.0, 0.0),
        V_WB: object = (0.0,) * 6,
        q_WP: object = (1.0, 0.0, 0.0, 0.0),
        p_WP: object = (0.0, 0.0, 0.0),
    ) -> "State":
        """State from values that broadcast to the shapes of the attributes; at rest unless V_WB is given.

        Raises:
            StateError: a value does not broadcast.
        """
        given = {"q_WB": q_WB, "p_WB": p_WB, "V_WB": V_WB, "q_WP": q_WP, "p_WP": p_WP}

        def full(name: str, shape: tuple[int, ...]) -> Tensor:
            value = given[name]
            try:
                return torch.as_tensor(value, dtype=torch.float64).expand(shape).clone()
            except (RuntimeError, TypeError, ValueError) as error:
                got = tuple(value.shape) if isinstance(value, Tensor) else value
                raise StateError(f"{name} is {got}; allowed: what broadcasts to {shape}") from error

        return State(*(full(name, shape) for name, shape in _shapes(model, num_worlds).items()))

    @property
    def num_worlds(self) -> int:
        """Number of worlds W."""
        return int(self.p_WP.shape[0])

    def check(self, model: Model) -> None:
        """Raise StateError unless shapes, dtype and values fit the model."""
        if not isinstance(self.p_WP, Tensor) or self.p_WP.ndim != 2 or not len(self.p_WP):
            got = tuple(self.p_WP.shape) if isinstance(self.p_WP, Tensor) else type(self.p_WP).__name__
            raise StateError(f"p_WP is {got}; allowed: a tensor of shape (W, 3), W at least 1")
        nb = model.num_bodies
        for name, shape in _shapes(model, self.num_worlds).items():
            check_tensor(name, getattr(self, name), shape, _LIMITS.get(name, math.inf))
        for name in ("q_WB", "q_WP"):
            norm = getattr(self, name).detach().norm(dim=-1)
            error = float((norm - 1.0).abs().max())
            if error > 1e-6:
                raise StateError(f"{name} has a quaternion with norm off by {error:.3g}; allowed: 1e-6")
        if model.floor_height is not None:
            radius = torch.as_tensor(model.arrays.radius[:nb], device=self.p_WB.device)
            depth = (model.floor_height - self.p_WB.detach()[..., 2]) - radius
            if float(depth.max()) > 0.0:
                world, body = (int(i) for i in torch.nonzero(depth > 0.0)[0])
                raise StateError(
                    f"p_WB[{world}, {body}] is {float(self.p_WB[world, body, 2])} m high; allowed: not all of it below "
                    f"the floor, {model.floor_height} m"
                )


def _shapes(model: Model, W: int) -> dict[str, tuple[int, ...]]:
    nb = model.num_bodies
    return {"q_WB": (W, nb, 4), "p_WB": (W, nb, 3), "V_WB": (W, nb, 6), "q_WP": (W, 4), "p_WP": (W, 3)}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Recorded frames of a rollout: states with a leading axis of F frames, frame 0 the initial state.

    Attributes:
        q_WB: (F, W, nb, 4).
        p_WB: (F, W, nb, 3), m.
        V_WB: (F, W, nb, 6), [rad/s; m/s].
        q_WP: (F, W, 4).
        p_WP: (F, W, 3), m.
        jams: (W,) int64, steps in which the pusher pressed as hard as it can; None from the "torch" backend, which
            counts nothing.
        lagged: (W,) int64, steps in which friction took its bound from an iteration before, because no solution was
            found where both agree; None from the "torch" backend.
        early: (W,) int64, steps in which something pressed before it touched, as the step held more impacts than are
            told apart; None from the "torch" backend.
        failed: (W,) bool, worlds that failed and are held in their first state, without gradients (see
            `Stepper.rollout`); None from the "torch" backend.
    """

    q_WB: Tensor
    p_WB: Tensor
    V_WB: Tensor
    q_WP: Tensor
    p_WP: Tensor
    jams: Tensor | None = None
    lagged: Tensor | None = None
    early: Tensor | None = None
    failed: Tensor | None = None

    @property
    def num_frames(self) -> int:
        """Number of frames F, that of the initial state included."""
        return int(self.p_WP.shape[0])

    def frame(self, index: int) -> State:
        """One frame as a state; negative indices count from the end."""
        return State(*(getattr(self, item.name)[index] for item in fields(State)))


def check_tensor(name: str, value: Tensor, shape: tuple[int, ...], most: float = math.inf) -> None:
    """Raise StateError unless `value` is a finite float64 tensor of this shape; name the first bad entry.

    Args:
        name: for the message.
        value: (*shape) float64, to check.
        shape: allowed.
        most: largest absolute value that is allowed.
    """
    if not isinstance(value, Tensor) or tuple(value.shape) != shape:
        got = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
        raise StateError(f"{name} is {got}; allowed: a tensor of shape {shape}")
    if value.dtype != torch.float64:
        raise StateError(f"{name} is {value.dtype}; allowed: torch.float64 (the physics is double precision)")
    if not value.numel():
        return
    entries = value.detach()
    if entries.device.type == "cpu":
        # numpy, because torch would wake its own pool of threads, which then compete with those of the kernels;
        # extrema, because they take no memory and pass on what is not a number.
        array = entries.numpy()
        low, high = float(array.min()), float(array.max())
    else:
        low, high = float(entries.min()), float(entries.max())
    if not (math.isfinite(low) and math.isfinite(high)):
        index = tuple(int(i) for i in torch.nonzero(~torch.isfinite(entries))[0])
        raise StateError(f"{name}{list(index)} is {float(value[index])}; allowed: finite numbers")
    if max(-low, high) > most:
        index = tuple(int(i) for i in torch.nonzero(entries.abs() > most)[0])
        raise StateError(f"{name}{list(index)} is {float(value[index]):g}; allowed: at most {most:g}")
