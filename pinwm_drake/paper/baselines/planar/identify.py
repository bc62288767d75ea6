# SPDX-License-Identifier: MIT
"""Identification in the plane: cell by cell masses and frictions with which a simulated push ends as the given one.

Source: Song and Boularias, "Learning to slide unknown objects with differentiable physics simulations" (RSS 2020): the
cells, the loss on their places, and descent along the gradient of the simulator. Deviations: Adam in the place of plain
descent, the poses during the push count and not the last one only, friction at the pusher is an unknown, and a prior
holds the cells near to each other, as one push does not tell them apart. The pusher's velocity is given, so that
nothing depends on the scale of the mass: that is held.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.capture.episodes import Episode, ObjectPoses, PusherTrajectory
from pinwm_drake.capture.scene import Capture
from pinwm_drake.errors import ParameterError, require
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.identification.time_step import LONGEST
from pinwm_drake.identification.unknowns import UNKNOWNS
from pinwm_drake.learning.options import Options
from pinwm_drake.paper.baselines.planar.body import PlanarBody
from pinwm_drake.paper.baselines.planar.rollout import PlanarParameters, PlanarPush, rollout, turned
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.scene import step_count
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.origin import Origin, registration_entry, seen_in
from pinwm_drake.twin.twin import THETA, Estimate, Twin, assemble_twin

MASSES = (0.2, 5.0)  # bounds, kg
_LAST_RATE = 0.05  # of the first learning rate
_VAGUE = 2.0  # standard deviation of the logits of frictions within their bounds, before any pose is seen


@dataclass(frozen=True)
class PlanarOptions(Options):
    """Options of the search.

    Attributes:
        starts: Number of guesses that descend side by side; the first is the middle of the bounds.
        rate: Learning rate at first, in units of the unknowns, which are of order one.
        noise: Standard deviation of the given places of cells, m, in the balance of poses and prior.
        spread_mass: Standard deviation of the logarithm of a cell's mass over the mean, before any pose is seen.
        spread_friction: That of its friction over the object's; a heavy and a rough cell brake alike, and objects are
            more often of one surface than of even weight.
        smoothness: Standard deviation of the difference of these logarithms between neighbours, over their own.
        time_step: s.
        friction: Least and largest coefficient of friction, at the floor and at the pusher.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ("seed",)

    starts: int = 4
    iterations: int = 150
    rate: float = 0.3
    noise: float = 1e-3
    spread_mass: float = 0.5
    spread_friction: float = 0.1
    smoothness: float = 0.3
    time_step: float = 1.0 / 240.0
    seed: int = 0
    friction: tuple[float, float] = (0.005, 0.5)

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.friction
        require("friction", self.friction, 0.0 < low < high < math.inf, "two numbers above 0 that rise")


@dataclass(frozen=True)
class PlanarProperties:
    """Properties of an object that slides.

    Attributes:
        mass: kg, as it was held.
        center: Centre of mass, x and y, m, frame Q of `PlanarBody`.
        inertia: About the vertical through the centre of mass, kg m^2.
        friction_floor: Coulomb coefficient of object and floor, mean over the weight.
        friction_pusher: Coulomb coefficient of object and pusher.
    """

    mass: float
    center: tuple[float, float]
    inertia: float
    friction_floor: float
    friction_pusher: float


@dataclass(frozen=True, eq=False)
class PlanarResult:
    """Result of a search.

    Attributes:
        properties: Properties of the object.
        cells: Mass [kg] and friction of each cell, (C, 2).
        poses: (N, 3), simulated x, y [m] and yaw [rad] at the given times.
        error: Root mean square of the distances of cells from where they were given, m.
        losses: (starts,), the lowest loss of each guess.
    """

    properties: PlanarProperties
    cells: np.ndarray
    poses: np.ndarray
    error: float
    losses: np.ndarray


def identify_planar(
    body: PlanarBody,
    poses: ObjectPoses,
    pusher: PusherTrajectory,
    radius: float,
    *,
    mass: float = 1.0,
    gravity: float = 9.81,
    options: PlanarOptions | None = None,
) -> PlanarResult:
    """Find masses and frictions of cells from the poses of an object during one push.

    Args:
        body: Geometry of the object, for the height of the pusher.
        poses: The N given poses, at rest at first; their times are those of the pusher.
        radius: Radius of the pusher, m.
        mass: Mass of the object, kg, which is held.
        gravity: m/s^2.

    Returns:
        The result; with the same inputs, the same.

    Raises:
        ParameterError: The mass is out of its bounds, or there are fewer than two poses.
        StateError: The pusher's motion is not finite.
        SolverError: A step of the simulator did not converge.
    """
    options = options or PlanarOptions()
    require("mass", mass, MASSES[0] <= mass <= MASSES[1], f"{MASSES[0]:g} to {MASSES[1]:g} kg")
    if len(poses.t) < 2 or not np.isfinite(poses.p_WO).all() or not np.isfinite(poses.q_WO).all():
        raise ParameterError(f"poses: got {len(poses.t)}, not all of them finite; allowed: two or more, all finite")
    problem = _Problem(body, poses, pusher, radius, mass, gravity, options)
    z, losses = _descend(problem, options)
    with torch.no_grad():
        best = z[int(losses.argmin())][None]
        found = problem.parameters(best)
        sliding = found.sliding(body, gravity)
        simulated = problem.simulate(found)
        properties = PlanarProperties(
            mass=float(sliding.mass),
            center=(float(sliding.center[0, 0]), float(sliding.center[0, 1])),
            inertia=float(sliding.inertia),
            friction_floor=float(sliding.load.sum() / (gravity * sliding.mass)),
            friction_pusher=float(found.friction_pusher),
        )
        error = float(problem.squares(simulated).mean().sqrt())
    cells = torch.stack([found.mass[0], found.friction[0]], -1).numpy()
    return PlanarResult(properties, cells, simulated[:, 0].numpy(), error, losses.numpy())


class _Problem:
    """Poses to explain, and what is known.

    The columns of z are the logits of both frictions within their bounds, then for each cell the logarithm of its
    friction over the object's, then of its mass over the mean, in units of their standard deviations.
    """

    def __init__(
        self,
        body: PlanarBody,
        poses: ObjectPoses,
        pusher: PusherTrajectory,
        radius: float,
        mass: float,
        gravity: float,
        options: PlanarOptions,
    ) -> None:
        self.body, self.mass, self.gravity, self.options = body, mass, gravity, options
        self.pairs = body.neighbours()
        h, after = options.time_step, np.asarray(poses.t, float) - float(poses.t[0])
        T = step_count(float(after[-1]), h)
        times = float(poses.t[0]) + h * np.arange(T + 1)
        path = np.stack([np.interp(times, pusher.t, pusher.p_WP[:, axis]) for axis in range(2)], axis=-1)
        self.push = PlanarPush(torch.from_numpy(path), radius, h)
        self.given = torch.from_numpy(body.planar(poses.q_WO, poses.p_WO))
        step = np.clip(np.floor(after / h).astype(int), 0, T - 1)
        self.step, self.share = torch.from_numpy(step), torch.from_numpy(after / h - step)[:, None, None]

    def parameters(self, z: Tensor) -> PlanarParameters:
        """Parameters of W guesses z (W, 2 + 2 C)."""
        low, high = self.options.friction
        floor, pusher = (low * (high / low) ** z[:, :2].sigmoid()).unbind(-1)
        friction, mass = z[:, 2:].chunk(2, dim=-1)
        return PlanarParameters(
            mass=self.mass * (self.options.spread_mass * mass).softmax(-1),
            friction=(floor[:, None] * (self.options.spread_friction * friction).exp()).clamp(low, high),
            friction_pusher=pusher,
        )

    def simulate(self, parameters: PlanarParameters) -> Tensor:
        """Poses (N, W, 3) at the given times: on the straight line between two steps."""
        start = self.given[:1].expand(len(parameters.mass), 3)
        found = rollout(self.body, parameters, start, self.push, gravity=self.gravity)
        return torch.lerp(found[self.step], found[self.step + 1], self.share)

    def squares(self, simulated: Tensor) -> Tensor:
        """Mean over the cells of the squares of their distances from where they are given, (N, W), m^2."""
        given = self.given[:, None]
        cells = self.body.cells
        middle = cells.mean(0)
        # Both poses are rigid: the mean distance is that of the middle, and one that grows with the angle between them.
        spread = (cells - middle).square().sum(-1).mean()
        found, wanted = (poses[..., :2] + turned(poses[..., 2], middle) for poses in (simulated, given))
        angle = simulated[..., 2] - given[..., 2]
        return (found - wanted).square().sum(-1) + 2.0 * spread * (1.0 - angle.cos())

    def losses(self, z: Tensor) -> Tensor:
        """Minus the logarithm of the posterior of W guesses, up to a constant."""
        squares = self.squares(self.simulate(self.parameters(z))).sum(0)
        prior = (z[:, :2] / _VAGUE).square().sum(-1) + z[:, 2:].square().sum(-1)
        for part in z[:, 2:].chunk(2, dim=-1):
            apart = (part[:, self.pairs[:, 0]] - part[:, self.pairs[:, 1]]) / self.options.smoothness
            prior = prior + apart.square().sum(-1)
        return 0.5 * (squares / self.options.noise**2 + prior)


def _descend(problem: _Problem, options: PlanarOptions) -> tuple[Tensor, Tensor]:
    """Return the best z (W, p) of each guess on its way down by Adam, and their losses (W,)."""
    size = 2 + 2 * len(problem.body.cells)
    generator = torch.Generator().manual_seed(options.seed)
    z = torch.zeros(options.starts, size, dtype=torch.float64)
    z[1:, :2] = _VAGUE * torch.randn(options.starts - 1, 2, generator=generator, dtype=torch.float64)
    best, lowest = z.clone(), torch.full((len(z),), math.inf, dtype=torch.float64)
    optimizer = torch.optim.Adam([z.requires_grad_()], betas=(0.8, 0.97), eps=1e-12)
    for iteration in range(1, options.iterations + 2):
        losses = problem.losses(z)
        better = losses.detach() < lowest
        lowest = torch.where(better, losses.detach(), lowest)
        best = torch.where(better[:, None], z.detach(), best)
        if iteration <= options.iterations:
            optimizer.param_groups[0]["lr"] = options.rate * _LAST_RATE ** (iteration / options.iterations)
            optimizer.zero_grad()
            losses.sum().backward()
            optimizer.step()
    return best, lowest


_HELD, _SCALED = "held", "of the mesh, scaled by what was found about the vertical"


def planar_twin(
    found: PlanarProperties,
    body: PlanarBody,
    capture: Capture,
    episodes: Sequence[Episode],
    surfels: Surfels,
    camera_offset: tuple[float, float],
    *,
    X_OS: Pose | None = None,
) -> Twin:
    """Twin of an object whose properties were found in the plane.

    Moments of inertia are those of a uniform solid, all scaled alike so that the one about the vertical is as found;
    the centre of mass moves in the plane only. No intervals are known.

    Args:
        body: Geometry with which they were found.
        episodes: The pushes that they were found from.
        camera_offset: px, of the principal points of the capture's cameras.
        X_OS: Where the static views have the object, against the pose in `capture.yaml`; None for the latter.

    Returns:
        The twin; its provenance lacks entries that only the caller knows, such as the command.

    Raises:
        InputError: A file of the capture cannot be read.
    """
    solid = mass_properties(load_mesh(capture.object.mesh_path), mass=1.0)
    up = body.R_QO[2]
    moments = solid.inertia.diagonal() * found.inertia / float(up @ solid.inertia @ up)
    moved = np.array([*found.center, 0.0]) - body.R_QO @ solid.p_com * np.array([1.0, 1.0, 0.0])
    values = {
        "mass": found.mass,
        **{f"inertia_{axis * 2}": float(moment) for axis, moment in zip("xyz", moments, strict=True)},
        "friction_floor": found.friction_floor,
        "friction_pusher": found.friction_pusher,
    }
    theta = {}
    for key, unit in THETA.items():
        free = key.startswith("friction")
        note = "" if free else _SCALED if key.startswith("inertia") else _HELD
        value = values[key] if key in values else UNKNOWNS[key].nominal
        theta[key] = Estimate(value, None, free, unit, note)
    center = {
        f"center_{axis}": Estimate(float(value), None, True, "m")
        for axis, value in zip("xyz", body.R_QO.T @ moved, strict=True)
    }
    seen = capture if X_OS is None else seen_in(capture, X_OS)
    return assemble_twin(
        capture,
        surfels,
        camera_offset,
        theta,
        center,
        {
            **Origin.of(capture, episodes).to_provenance(),
            **registration_entry(capture.object.X_WO, seen.object.X_WO),
            "method": "2d-physics",
        },
        lift=0.0,
        time_step=LONGEST,
    )
