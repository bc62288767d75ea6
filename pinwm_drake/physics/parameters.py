# SPDX-License-Identifier: MIT
"""The physical parameters theta of all worlds."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.errors import ParameterError
from pinwm_drake.physics.model import FLOOR, HEAVIEST, LEAST_GYRATION, LIGHTEST, PUSHER, Model, check_mass_properties
from pinwm_drake.physics.state import TensorFields, check_tensor

_MOST_FRICTION = 100.0
_MOST_OFFSET, _MOST_CENTER = 0.05, 1.0  # m
_LEAST_SPREAD, _MOST_SPREAD = 0.1, 10.0

_TINY = 1e-12
_LOWER = [1, 2, 2], [0, 0, 1]  # rows and columns of a matrix below its diagonal


@dataclass(frozen=True, eq=False)
class Parameters(TensorFields):
    """Physical parameters theta of W worlds; float64, one device.

    Attributes:
        mass: (W, nb), kg.
        inertia: (W, nb, 3, 3), about the centre of mass, body frame, kg m^2.
        friction: (W, num_pairs), Coulomb coefficient of each pair, in the order of `Model.pair_names`, up to 100.
        restitution: (W, num_pairs), coefficient of restitution of each pair, in [0, 1].
        center: (W, nb, 3), centre of mass B in the frame of the pieces (axes of B, origin at the nominal centre), m;
            zero without it, and in models with joints.
        spread: (W, nb, 3), factors by which the pressure on a resting face is spread along the axes of B, about the
            foot of the nominal centre; see `geometry.floor.spread_point`. One without it.
        offset: (W, num_pairs), gap at which the two of a pair touch, m: how much larger they act than their pieces.
            Zero without it.
    """

    mass: Tensor
    inertia: Tensor
    friction: Tensor
    restitution: Tensor
    center: Tensor = None  # type: ignore[assignment]  # made in __post_init__
    spread: Tensor = None  # type: ignore[assignment]
    offset: Tensor = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """Give what was left out its nominal value."""
        if self.center is None:
            object.__setattr__(self, "center", self.mass.new_zeros(*self.mass.shape, 3))
        if self.spread is None:
            object.__setattr__(self, "spread", self.mass.new_ones(*self.mass.shape, 3))
        if self.offset is None:
            object.__setattr__(self, "offset", torch.zeros_like(self.friction))

    @staticmethod
    def nominal(
        model: Model,
        *,
        friction_floor: float = 0.5,
        friction_pusher: float = 0.5,
        friction_bodies: float = 0.5,
        restitution_floor: float = 0.0,
        restitution_pusher: float = 0.0,
        restitution_bodies: float = 0.0,
        num_worlds: int = 1,
    ) -> "Parameters":
        """Return the model's nominal mass properties with one coefficient for each kind of pair.

        Raises:
            ParameterError: a coefficient is out of range.
        """

        def of_pairs(floor: float, pusher: float, bodies: float) -> Tensor:
            kinds = [name.rsplit("-", 1)[1] for name in model.pair_names]
            values = [{FLOOR: floor, PUSHER: pusher}.get(kind, bodies) for kind in kinds]
            return torch.tensor([values] * num_worlds, dtype=torch.float64).reshape(num_worlds, -1)

        parameters = Parameters(
            mass=torch.tensor([[body.mass for body in model.bodies]] * num_worlds, dtype=torch.float64),
            inertia=torch.stack([torch.as_tensor(body.inertia, dtype=torch.float64) for body in model.bodies])
            .expand(num_worlds, -1, -1, -1)
            .clone(),
            friction=of_pairs(friction_floor, friction_pusher, friction_bodies),
            restitution=of_pairs(restitution_floor, restitution_pusher, restitution_bodies),
        )
        parameters.check(model)
        return parameters

    @property
    def num_worlds(self) -> int:
        """Number of worlds W."""
        return int(self.mass.shape[0])

    def check(self, model: Model) -> None:
        """Raise ParameterError (ranges), StateError (shapes, dtype) or ModelError (inertia) unless valid."""
        W, nb, pairs = self.num_worlds, model.num_bodies, model.pair_names
        each, of_pairs = (W, nb, 3), (W, len(pairs))
        shapes = ((W, nb), (W, nb, 3, 3), of_pairs, of_pairs, each, each, of_pairs)
        for item, shape in zip(fields(self), shapes, strict=True):
            check_tensor(item.name, getattr(self, item.name), shape)
        most = 0.0 if model.joints else _MOST_CENTER
        for name, lower, upper in (
            ("friction", 0.0, _MOST_FRICTION),
            ("restitution", 0.0, 1.0),
            ("offset", -_MOST_OFFSET, _MOST_OFFSET),
            ("center", -most, most),
            ("spread", _LEAST_SPREAD, _MOST_SPREAD),
        ):
            values = getattr(self, name).detach()
            bad = torch.nonzero((values < lower) | (values > upper))
            if len(bad):
                world, at, *axes = bad[0].tolist()
                what = f"{model.bodies[at].name!r} along axis {axes[0]}" if axes else f"{pairs[at]!r}"
                value = float(values[(world, at, *axes)])
                allowed = f"from {lower:g} to {upper:g}"
                raise ParameterError(f"{name} of {what} in world {world} is {value}; allowed: {allowed}")
        moments = torch.linalg.eigvalsh(self.inertia.detach())
        mass = self.mass.detach()
        wrong = (mass < LIGHTEST) | (mass > HEAVIEST) | (moments[..., 0] < mass * LEAST_GYRATION**2)
        wrong |= moments[..., 0] + moments[..., 1] < moments[..., 2] * (1.0 - 1e-9)
        wrong |= (self.inertia.detach() - self.inertia.detach().mT).abs().amax((-2, -1)) > 1e-12 * moments[..., 2]
        if bool(wrong.any()):
            world, body = (int(i) for i in torch.nonzero(wrong)[0])
            name = f"{model.bodies[body].name} in world {world}"
            check_mass_properties(name, float(self.mass[world, body]), self.inertia[world, body].detach().cpu().numpy())

    def expand(self, num_worlds: int) -> "Parameters":
        """Parameters of one world, repeated for `num_worlds` worlds."""
        return self.changed(lambda tensor: tensor.expand(num_worlds, *tensor.shape[1:]))

    def unconstrained(self) -> dict[str, Tensor]:
        """Unbounded tensors of theta, by name.

        They are log_mass (W, nb), log_cholesky (W, nb, 6), log_friction and logit_restitution (W, num_pairs), and the
        inverse hyperbolic tangents, over their bounds, of center, the logarithm of spread (W, nb, 3), and offset.
        The six numbers are the logarithms of the diagonal of the Cholesky factor L of the second moment
        Sigma / mass = L L', then its entries 21, 31, 32 over the diagonal's mean. Coefficients are kept 1e-12 away
        from where the logarithm ends.
        """
        eye = torch.eye(3, dtype=self.inertia.dtype, device=self.inertia.device)
        moment = 0.5 * self.inertia.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None] * eye - self.inertia
        L = torch.linalg.cholesky(moment / self.mass[..., None, None])
        diagonal = L.diagonal(dim1=-2, dim2=-1)
        lower = L[..., *_LOWER] / diagonal.mean(-1, keepdim=True)
        return {
            "log_mass": self.mass.log(),
            "log_cholesky": torch.cat([diagonal.log(), lower], -1),
            "log_friction": self.friction.clamp_min(_TINY).log(),
            "logit_restitution": self.restitution.clamp(_TINY, 1.0 - _TINY).logit(),
            "atanh_center": _bounded(self.center / _MOST_CENTER),
            "atanh_spread": _bounded(self.spread.log() / math.log(_MOST_SPREAD)),
            "atanh_offset": _bounded(self.offset / _MOST_OFFSET),
        }

    @staticmethod
    def from_unconstrained(values: dict[str, Tensor]) -> "Parameters":
        """Parameters from unbounded tensors, the inverse of `unconstrained`; differentiable."""
        mass = values["log_mass"].exp()
        diagonal = values["log_cholesky"][..., :3].exp()
        L = torch.diag_embed(diagonal)
        L[..., *_LOWER] = values["log_cholesky"][..., 3:] * diagonal.mean(-1, keepdim=True)
        moment = mass[..., None, None] * (L @ L.mT)
        trace = moment.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
        eye = torch.eye(3, dtype=mass.dtype, device=mass.device)
        return Parameters(
            mass=mass,
            inertia=trace * eye - moment,
            friction=values["log_friction"].exp(),
            restitution=values["logit_restitution"].sigmoid(),
            center=_MOST_CENTER * values["atanh_center"].tanh(),
            spread=(math.log(_MOST_SPREAD) * values["atanh_spread"].tanh()).exp(),
            offset=_MOST_OFFSET * values["atanh_offset"].tanh(),
        )


def kernel_arrays(
    parameters: Parameters, V_WP: Tensor, states: Iterable[Tensor]
) -> tuple[tuple[np.ndarray, ...], np.ndarray, tuple[np.ndarray, ...]]:
    """Arrays for kernels: of the parameters, of the velocities V_WP (T, W, 6) [rad/s, m/s], and of states over time."""

    def arrays(tensors: Iterable[Tensor]) -> tuple[np.ndarray, ...]:
        return tuple(np.ascontiguousarray(tensor.detach().cpu().numpy()) for tensor in tensors)

    return arrays(parameters.tensors()), arrays([V_WP])[0], arrays(states)


def _bounded(share: Tensor) -> Tensor:
    """Inverse hyperbolic tangent, kept away from where it ends."""
    return share.clamp(_TINY - 1.0, 1.0 - _TINY).atanh()
