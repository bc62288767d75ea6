# SPDX-License-Identifier: MIT
"""Identification of a twin as ASID does it: theta whose simulated poses are nearest to the poses that were tracked.

Source: Memmel et al., "ASID: Active Exploration for System Identification in Robotic Manipulation" (ICLR 2024), its
second stage. Deviations: the push is a recorded one, not one of an exploration policy, and the simulator is this
project's.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.capture.episodes import Episode, ObjectPoses, pose_at
from pinwm_drake.capture.scene import Capture
from pinwm_drake.errors import ParameterError, SolverError, require
from pinwm_drake.geometry.meshes import half_diagonal
from pinwm_drake.identification.expansion import deviation
from pinwm_drake.identification.forward import Forward, inertia
from pinwm_drake.identification.identify import NOMINAL_MASS, capture_scene, distinct_pushes
from pinwm_drake.identification.poses.tracker import PoseTracker, PoseTrackerOptions
from pinwm_drake.identification.unknowns import UNKNOWNS
from pinwm_drake.paper.baselines.asid.cross_entropy import CrossEntropyBudget, Minimum, minimise
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.scene import Scene, resting_height
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.threads import available
from pinwm_drake.twin.document import to_plain
from pinwm_drake.twin.origin import Origin, registration_entry, seen_in
from pinwm_drake.twin.rollout import NO_EFFECT
from pinwm_drake.twin.twin import THETA, Estimate, Twin, assemble_twin

Span = tuple[float, float]
_FRICTIONS = ("friction_floor", "friction_pusher")
_RESTITUTIONS = ("restitution_floor", "restitution_pusher")


@dataclass(frozen=True)
class AsidOptions:
    """Settings of a search for theta by simulated poses.

    Attributes:
        budget: Simulations that the search may use.
        friction: Range of both coefficients of friction. Objects that are flipped rather than pushed grip more, 0.05
            to 1.
        restitution: Range of both coefficients of restitution.
        inertia: Range of the factor of all moments of inertia, against a uniform solid of the same mass.
        mass: Range of the mass, kg, where it is looked for.
        free: Names of what is looked for; None for everything but a mass that the capture tells.
        held: Values of what is not looked for, by name; with the inertia held, the mass has an effect.
        tracker: Settings of the pose tracker.
        time_step: Time step of the physics, s.
        num_threads: Threads of the physics; None for one on each core.
    """

    budget: CrossEntropyBudget = field(default_factory=CrossEntropyBudget)
    friction: Span = (0.005, 0.5)
    restitution: Span = (0.0, 0.5)
    inertia: Span = (0.3, 3.0)
    mass: Span = (0.2, 5.0)
    free: tuple[str, ...] | None = None
    held: Mapping[str, float] = field(default_factory=dict)
    tracker: PoseTrackerOptions = field(default_factory=PoseTrackerOptions)
    time_step: float = 1.0 / 240.0
    num_threads: int | None = None

    def __post_init__(self) -> None:
        most = {"friction": 5.0, "restitution": 1.0, "inertia": 20.0, "mass": 1e3}
        for name, end in most.items():
            low, high = getattr(self, name)
            least = 0.0 if name == "restitution" else 1e-4
            allowed = f"two numbers of {least:g} to {end:g}, the first below the second"
            require(name, (low, high), least <= low < high <= end, allowed)
        require("time_step", self.time_step, 1e-5 <= self.time_step <= 0.05, "1e-5 to 0.05 s")
        names = {*_FRICTIONS, *_RESTITUTIONS, "inertia", "mass"}
        chosen = set(self.free or names)
        require("free", self.free, chosen <= names, ", ".join(sorted(names)))
        if self.free is not None:
            held = names - chosen - {"mass"}
            require("held", sorted(self.held), held <= set(self.held) <= names - chosen, f"{', '.join(sorted(held))}")
        number = self.num_threads
        require("num_threads", number, number is None or number >= 1, "1 or more, or none")

    def ranges(self, *, mass_known: bool) -> dict[str, Span]:
        """Ranges of the unknowns, by the names of `THETA`; "inertia" is the factor of all three moments."""
        found = dict.fromkeys(_FRICTIONS, self.friction) | dict.fromkeys(_RESTITUTIONS, self.restitution)
        found |= {"inertia": self.inertia, "mass": self.mass}
        names = self.free or [name for name in found if name != "mass" or not mass_known]
        return {name: found[name] for name in names}


def physical(points: np.ndarray, ranges: Mapping[str, Span]) -> dict[str, np.ndarray]:
    """Physical values (W,) of points (W, d) of the unit cube, by name; what is positive counts by its logarithm.

    Args:
        points: A column for each of `ranges`, in their order.
        ranges: Low and high ends, by name.
    """
    values = {}
    for share, (name, (low, high)) in zip(points.T, ranges.items(), strict=True):
        values[name] = low * (high / low) ** share if low > 0.0 else low + (high - low) * share
    return values


_NOTE = "by a cross-entropy search: a point, without an interval"
_MASS_NOTE = f"{_NOTE}; with a velocity-driven pusher only ratios to the mass have an effect"
_MOMENTS = ("moment_xx", "moment_yy", "moment_zz")
# How far poses may begin after the first frame, or end before the last one [s]: times printed with six decimals.
_ROUNDING = 1.5e-6


@dataclass(frozen=True, eq=False)
class AsidIdentification:
    """Twin that ASID identified, and what it was made from.

    Attributes:
        twin: The twin; its provenance lacks entries that only the caller knows, such as the command.
        poses: Poses of the object in each push that the search was to reproduce.
        minimum: The search; values are mean squares, m^2: distance, and angle times the object's radius.
    """

    twin: Twin
    poses: list[ObjectPoses]
    minimum: Minimum


def identify_asid(
    capture: Capture,
    episodes: Episode | Sequence[Episode],
    surfels: Surfels,
    camera_offset: tuple[float, float],
    options: AsidOptions | None = None,
    *,
    seed: int,
    X_OS: Pose | None = None,
    poses: Sequence[ObjectPoses] | None = None,
) -> AsidIdentification:
    """Find theta such that simulated pushes move the object as it was tracked.

    Args:
        capture: Object, pusher, floor, gravity.
        episodes: The push, or the pushes.
        surfels: The object's appearance, frame O.
        camera_offset: px, added to the principal points of the episodes' cameras.
        options: Settings; None for the default ones.
        seed: Seed of the search, 0 or more.
        X_OS: Where the static views have the object, against the pose in `capture.yaml`; None for the latter.
        poses: Poses of the object in each push; None for those of a `PoseTracker`.

    Returns:
        The twin and the search.

    Raises:
        InputError: Images or meshes cannot be used, or the object is not where the capture has it.
        ParameterError: There is no episode, or one comes twice, or poses do not cover its frames.
        SolverError: The physics found no solution for any guess.
    """
    options = options or AsidOptions()
    pushes = distinct_pushes(episodes)
    origin, written = Origin.of(capture, pushes), capture.object.X_WO
    capture = capture if X_OS is None else seen_in(capture, X_OS)
    begun = time.process_time()
    tracked = poses is None
    if poses is None:
        tracker = PoseTracker(capture, surfels, camera_offset, options.tracker)
        poses = [tracker.track(push).poses for push in pushes]
    scene = capture_scene(capture, options.time_step)
    mass = capture.object.mass or NOMINAL_MASS
    ranges = options.ranges(mass_known=capture.object.mass is not None)
    number = options.num_threads or available()
    matches = [
        _Match(Forward(scene, push, capture.object.X_WO, mass, number), one)
        for push, one in zip(pushes, poses, strict=True)
    ]

    def loss(points: np.ndarray) -> np.ndarray:
        values = _values(points, ranges, options.held, mass)
        found: np.ndarray = np.mean([match.loss(values) for match in matches], axis=0)
        return found

    minimum = minimise(loss, len(ranges), options.budget, np.random.default_rng(seed))
    if not np.isfinite(minimum.value):
        raise SolverError("the physics found no solution for any guess; try another seed or a smaller time step")
    best = _values(minimum.point[None], ranges, options.held, mass)
    twin = assemble_twin(
        capture,
        surfels,
        camera_offset,
        _theta(scene, mass, best, set(ranges)),
        {},
        {
            **origin.to_provenance(),
            **registration_entry(written, capture.object.X_WO),
            "method": "asid",
            "poses": "tracked" if tracked else "given",
            "seed": seed,
            "loss": minimum.value,
            "seconds": round(time.process_time() - begun, 2),
            "options": to_plain(asdict(options)),
        },
        lift=float(capture.object.X_WO.p[2]) - resting_height(scene, capture.object.X_WO.q),
        time_step=options.time_step,
        acts_as=scene.acts_as,
    )
    return AsidIdentification(twin, list(poses), minimum)


class _Match:
    """Comparison of simulated poses with those of one push, at whose frames these are interpolated."""

    def __init__(self, forward: Forward, poses: ObjectPoses) -> None:
        episode = forward.episode
        t, first, last = episode.t, float(poses.t[0]), float(poses.t[-1])
        if first > t[0] + _ROUNDING or last < t[-1] - _ROUNDING:
            allowed = f"poses from {t[0]:g} to {t[-1]:g} s, the frames of episode {episode.name}"
            raise ParameterError(f"poses: got {first:g} to {last:g} s; allowed: {allowed}")
        found = [pose_at(poses.t, poses.p_WO, poses.q_WO, float(one)) for one in t]
        self.X_WO = Pose(torch.stack([X.q for X in found])[:, None], torch.stack([X.p for X in found])[:, None])
        _, _, yaw, x, y, _ = deviation(found[0], forward.X_WO).tolist()
        self.forward = replace(forward, chosen=torch.arange(len(t)))
        nominal = {name: unknown.nominal for name, unknown in UNKNOWNS.items()}
        self.held = nominal | NO_EFFECT | {"start_x": x, "start_y": y, "start_yaw": yaw}

    @torch.no_grad()
    def loss(self, values: dict[str, np.ndarray]) -> np.ndarray:
        """Mean squares (W,) [m^2] for W values of theta; infinite where the physics found no solution."""
        W = len(values["inertia"])
        unknowns = {name: torch.full((W,), value, dtype=torch.float64) for name, value in self.held.items()}
        X, alive = self.forward.poses(unknowns | _unknowns(values, self.forward.mass))
        far = deviation(X, self.X_WO)
        far[..., :3] *= half_diagonal(self.forward.scene.mesh)
        return torch.where(alive, far.square().sum(-1).mean(0), torch.inf).numpy()


def _values(
    points: np.ndarray, ranges: Mapping[str, Span], held: Mapping[str, float], mass: float
) -> dict[str, np.ndarray]:
    """Physical values (W,) of points (W, d) of the unit cube, and of what is held; the inertia for a mass [kg]."""
    found = {name: np.full(len(points), value) for name, value in held.items()} | physical(points, ranges)
    if "inertia" in held and "mass" in ranges:
        found["inertia"] *= mass / found["mass"]  # what is held is the inertia, and not its share of the mass
    return found


def _unknowns(values: dict[str, np.ndarray], mass: float) -> dict[str, Tensor]:
    """Values (W,) by the names of `UNKNOWNS`, in which moments are factors for a nominal mass [kg]."""
    found = {name: torch.from_numpy(value) for name, value in values.items() if name != "inertia"}
    found.setdefault("mass", torch.full((len(values["inertia"]),), mass, dtype=torch.float64))
    return found | dict.fromkeys(_MOMENTS, torch.from_numpy(values["inertia"]) * found["mass"] / mass)


def _theta(scene: Scene, mass: float, values: dict[str, np.ndarray], sought: set[str]) -> dict[str, Estimate]:
    """Estimates of theta from the values (1,) of what was sought and held; without one, the mass [kg] is as given."""
    unknowns = _unknowns(values, mass)
    moments = inertia(scene, mass, unknowns)[0].diagonal().tolist()
    found = {f"inertia_{axis * 2}": moment for axis, moment in zip("xyz", moments, strict=True)}
    found |= {name: float(unknowns[name][0]) for name in THETA if name not in found}
    notes = {name: _NOTE if name in sought or name.startswith("inertia") else "held" for name in THETA}
    notes["mass"] = _MASS_NOTE if "mass" in sought else "held" if "mass" in values else "as the capture says"
    return {name: Estimate(found[name], None, False, unit, notes[name]) for name, unit in THETA.items()}
