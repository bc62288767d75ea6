"""State, which changes in a rollout: poses and velocities of all worlds."""

from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.errors import StateError
from pinwm_drake.physics.model import Model


@dataclass(frozen=True, eq=False)
class State:
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
        """State from values that broadcast to the shapes of the attributes; at rest unless V_WB is given."""
        nb = model.num_bodies

        def full(value: object, *shape: int) -> Tensor:
            return torch.as_tensor(value, dtype=torch.float64).expand(num_worlds, *shape).clone()

        return State(full(q_WB, nb, 4), full(p_WB, nb, 3), full(V_WB, nb, 6), full(q_WP, 4), full(p_WP, 3))

    @property
    def num_worlds(self) -> int:
        """Number of worlds W."""
        return int(self.p_WP.shape[0])

    def check(self, model: Model) -> None:
        """Raises StateError unless shapes, dtype and values fit the model."""
        W, nb = self.num_worlds, model.num_bodies
        shapes = {"q_WB": (W, nb, 4), "p_WB": (W, nb, 3), "V_WB": (W, nb, 6), "q_WP": (W, 4), "p_WP": (W, 3)}
        for name, shape in shapes.items():
            check_tensor(name, getattr(self, name), shape)
        for name in ("q_WB", "q_WP"):
            norm = getattr(self, name).detach().norm(dim=-1)
            error = float((norm - 1.0).abs().max())
            if error > 1e-6:
                raise StateError(f"{name} has a quaternion with norm off by {error:.3g}; allowed: 1e-6")

    def detach(self) -> "State":
        """State with the same numbers, cut from the graph that autograd keeps."""
        return State(*(getattr(self, item.name).detach() for item in fields(self)))

    def to(self, device: torch.device | str) -> "State":
        """Copy of the state on another device."""
        return State(*(getattr(self, item.name).to(device) for item in fields(self)))


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Recorded frames of a rollout: states with a leading axis of F frames, frame 0 the initial state.

    Attributes:
        q_WB: (F, W, nb, 4).
        p_WB: (F, W, nb, 3), m.
        V_WB: (F, W, nb, 6), [rad/s; m/s].
        q_WP: (F, W, 4).
        p_WP: (F, W, 3), m.
    """

    q_WB: Tensor
    p_WB: Tensor
    V_WB: Tensor
    q_WP: Tensor
    p_WP: Tensor

    @property
    def num_frames(self) -> int:
        """Number of frames F, that of the initial state included."""
        return int(self.p_WP.shape[0])

    def frame(self, index: int) -> State:
        """One frame as a state; negative indices count from the end."""
        return State(*(getattr(self, item.name)[index] for item in fields(self)))


def check_tensor(name: str, value: Tensor, shape: tuple[int, ...]) -> None:
    """Raises StateError unless `value` is a finite float64 tensor of this shape; names the first bad entry."""
    if not isinstance(value, Tensor) or tuple(value.shape) != shape:
        got = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
        raise StateError(f"{name} is {got}; allowed: a tensor of shape {shape}")
    if value.dtype != torch.float64:
        raise StateError(f"{name} is {value.dtype}; allowed: torch.float64 (the physics is double precision)")
    entries = value.detach()
    if entries.device.type == "cpu":
        # numpy, because torch would wake its own pool of threads, which then compete with those of the kernels;
        # extrema, because they take no memory and pass on what is not a number.
        array = entries.numpy()
        finite = bool(np.isfinite(array.min(initial=0.0)) and np.isfinite(array.max(initial=0.0)))
    else:
        finite = bool(torch.isfinite(entries).all())
    if not finite:
        index = tuple(int(i) for i in torch.nonzero(~torch.isfinite(entries))[0])
        raise StateError(f"{name}{list(index)} is {float(value[index])}; allowed: finite numbers")
