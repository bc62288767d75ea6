# SPDX-License-Identifier: MIT
"""Model of a scene, constant in a rollout: bodies, joints, pusher, floor, time step and the solver's constants."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from pinwm_drake.errors import ModelError
from pinwm_drake.geometry.pieces import ANYHOW, CYLINDER, MAX_FLOOR_POINTS, ConvexPiece, pack_pieces
from pinwm_drake.physics.kernels.arrays import ANGULAR_HINGE, ANGULAR_LOCKED, LINEAR, ModelArrays

PUSHER = "pusher"
FLOOR = "floor"

# What no table-top scene has: it would be an error of units.
_LONGEST_STEP = 0.1  # s
_SMALLEST, _LARGEST = 1e-5, 100.0  # m, of a piece
LIGHTEST, HEAVIEST = 1e-6, 1e4  # kg
LEAST_GYRATION = 1e-6  # m
# Change of a body's speed that a hit of the pusher may make within one step, m/s: above what table-top pushers do.
_IMPACT_SPEED = 3.0
# A joint row's compliance over the contacts': it only settles redundant rows.
_JOINT_OVER_CONTACT = 1e-3


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body with nominal mass properties.

    Attributes:
        name: unique in a model; not "pusher" or "floor".
        pieces: convex pieces in the body frame B, whose origin is the centre of mass.
        mass: nominal mass, kg.
        inertia: (3, 3), nominal inertia about the centre of mass, axes of B, kg m^2.
        floor_points: (n, 3), points with which it touches the floor, frame B, m, or (n, 7) with their owners and faces
            (see `geometry.patch.supporting_points`); None for those of its pieces.
        even_lines: whether the pressure is even on a line on which a round piece lies; otherwise its ends carry it.
    """

    name: str
    pieces: Sequence[ConvexPiece]
    mass: float
    inertia: np.ndarray
    floor_points: np.ndarray | None = None
    even_lines: bool = False


@dataclass(frozen=True, eq=False)
class Joint:
    """A bilateral constraint between body A and body B, "pusher" or the world (None).

    Attributes:
        kind: "fixed" (no relative motion), "no_rotation" (relative rotation R_BA stays), "no_translation" (the
            anchors do not part along axis_B), "hinge" (the anchors coincide, axis_A stays along axis_B).
        body_A: name of body A.
        body_B: name of body B, "pusher", or None for the world.
        p_A: (3,), anchor in body frame A, m.
        p_B: (3,), anchor in body frame B (world frame if B is None), m.
        axis_A: (3,), hinge axis in A.
        axis_B: (3,), hinge axis or blocked direction in B.
        R_BA: (3, 3), relative rotation that "fixed" and "no_rotation" keep.
        collide: whether contacts between the two bodies still count.

    Source: Cline (2002), section 2.5; PIN-WM, section III-A lists the same kinds.
    """

    kind: Literal["fixed", "no_rotation", "no_translation", "hinge"]
    body_A: str
    body_B: str | None = None
    p_A: Sequence[float] = (0.0, 0.0, 0.0)
    p_B: Sequence[float] = (0.0, 0.0, 0.0)
    axis_A: Sequence[float] = (0.0, 0.0, 1.0)
    axis_B: Sequence[float] = (0.0, 0.0, 1.0)
    R_BA: np.ndarray = field(default_factory=lambda: np.eye(3))
    collide: bool = False


@dataclass(frozen=True, eq=False)
class Model:
    """Frozen model of a scene: bodies, joints, pusher, floor, time step and the solver's constants.

    Attributes:
        bodies: dynamic bodies.
        pusher: convex pieces of the velocity-driven pusher in its frame P, or None.
        floor_height: height of the static floor, m, or None for no floor.
        gravity: (3,), m/s^2, world frame.
        time_step: h, s.
        joints: bilateral constraints.
        contact_margin: contacts nearer than this, plus what bodies may travel within a step, take part, m.
        compliance: contact compliance relative to a body's inverse mass; see `kernels/cone.py`.
        max_contacts: contacts of one world at the most; more is an error. Memory grows with what there are.
        pusher_force: force with which the pusher presses at most, N, shared among the contacts that it has with a body,
            beyond the impulse that gives the body 3 m/s; what resists more, such as a floor behind the body, it enters.
            Such steps are counted; see `Trajectory.jams`.

    Raises:
        ModelError: names, sizes or values contradict each other; the message says which.
    """

    bodies: Sequence[Body]
    pusher: Sequence[ConvexPiece] | None = None
    floor_height: float | None = 0.0
    gravity: Sequence[float] = (0.0, 0.0, -9.81)
    time_step: float = 1.0 / 240.0
    joints: Sequence[Joint] = ()
    contact_margin: float = 1e-3
    compliance: float = 1e-5
    max_contacts: int = 1024
    pusher_force: float = 500.0

    def __post_init__(self) -> None:
        names = [body.name for body in self.bodies]
        if not names:
            raise ModelError("a model has no bodies; allowed: one or more")
        for name in names:
            if names.count(name) > 1 or name in (PUSHER, FLOOR):
                raise ModelError(f"body name {name!r} is taken; allowed: unique, not {PUSHER!r} or {FLOOR!r}")
        for body in self.bodies:
            check_mass_properties(body.name, body.mass, body.inertia)
            _check_pieces(f"pieces of {body.name!r}", body.pieces)
        if self.pusher is not None:
            _check_pieces("pieces of the pusher", self.pusher)
        for name, value, most in (
            ("time_step", self.time_step, _LONGEST_STEP),
            ("contact_margin", self.contact_margin, math.inf),
            ("compliance", self.compliance, math.inf),
            ("pusher_force", self.pusher_force, 1e9),
        ):
            if not (_is_number(value) and 0.0 < value <= most):
                raise ModelError(f"{name} is {value}; allowed: positive, at most {most:g}")
        if self.floor_height is not None and not _is_number(self.floor_height):
            raise ModelError(f"floor_height is {self.floor_height}; allowed: a finite number, m, or None")
        if not isinstance(self.max_contacts, int) or self.max_contacts < 1:
            raise ModelError(f"max_contacts is {self.max_contacts}; allowed: at least 1")
        check_vector("gravity", self.gravity, "m/s^2")
        for joint in self.joints:
            self._check_joint(joint, names)

    def _check_joint(self, joint: Joint, names: list[str]) -> None:
        if joint.kind not in ("fixed", "no_rotation", "no_translation", "hinge"):
            raise ModelError(f"joint kind {joint.kind!r}; allowed: fixed, no_rotation, no_translation, hinge")
        others = [*names, None] + ([PUSHER] if self.pusher is not None else [])
        if joint.body_A not in names or joint.body_B not in others or joint.body_A == joint.body_B:
            raise ModelError(
                f"joint between {joint.body_A!r} and {joint.body_B!r}; allowed: two different ones of {others}"
            )
        for name in ("p_A", "p_B", "axis_A", "axis_B"):
            check_vector(f"{name} of a joint of {joint.body_A!r}", getattr(joint, name), "m")
        for axis in (joint.axis_A, joint.axis_B):
            if not np.linalg.norm(axis) > 0.0:
                raise ModelError(f"joint axis {tuple(axis)}; allowed: a vector that is not zero")

    @property
    def num_bodies(self) -> int:
        """Number of dynamic bodies."""
        return len(self.bodies)

    @property
    def contact_rows(self) -> int:
        """Rows of the contact tables: one more than allowed, which shows that there are too many."""
        return self.max_contacts + 1

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs (A, B) that may touch, in the order of the parameters' pair columns.

        B counts on after the bodies: num_bodies is the pusher, num_bodies + 1 the floor.
        """
        nb = self.num_bodies
        jointed = {
            frozenset((self._index(joint.body_A), self._index(joint.body_B)))
            for joint in self.joints
            if not joint.collide and joint.body_B is not None
        }
        pairs = []
        if self.floor_height is not None:
            pairs += [(b, nb + 1) for b in range(nb)]
        if self.pusher is not None:
            pairs += [(b, nb) for b in range(nb)]
        pairs += [(a, b) for a in range(nb) for b in range(a + 1, nb)]
        return [pair for pair in pairs if frozenset(pair) not in jointed]

    @property
    def pair_names(self) -> list[str]:
        """Names of the pairs, such as "t_block-floor"."""
        names = [body.name for body in self.bodies] + [PUSHER, FLOOR]
        return [f"{names[a]}-{names[b]}" for a, b in self.pairs]

    def _index(self, name: str | None) -> int:
        if name is None:
            return self.num_bodies + 1
        if name == PUSHER:
            return self.num_bodies
        return [body.name for body in self.bodies].index(name)

    @cached_property
    def arrays(self) -> ModelArrays:
        """The model in the form the kernels read."""
        nb = self.num_bodies
        all_pieces = [list(body.pieces) for body in self.bodies]
        if self.pusher is not None:
            all_pieces.append(list(self.pusher))
        pair_index = np.full((nb, nb + 2), -1, np.int64)
        for i, (a, b) in enumerate(self.pairs):
            pair_index[a, b] = i
        radius = [
            max(float(np.max(np.linalg.norm(piece.vertices, axis=1))) + piece.radius for piece in pieces)
            for pieces in all_pieces
        ]
        masses = np.array([body.mass for body in self.bodies])
        weight = np.array([[body.mass * radius[i] ** 2, body.mass] for i, body in enumerate(self.bodies)])
        table = pack_pieces(
            all_pieces, [body.floor_points for body in self.bodies], [body.even_lines for body in self.bodies]
        )
        owners = np.split(table.floor_owners, table.bodies[1:-1, 1])
        rims = np.array([any(piece.kind == CYLINDER for piece in body.pieces) for body in self.bodies])
        compliance = self.compliance / float(masses.mean())
        rows = [row for joint in self.joints for row in self.joint_rows(joint)]
        return ModelArrays(
            num_bodies=nb,
            num_kinematic=int(self.pusher is not None),
            floor_height=float(self.floor_height or 0.0),
            gravity=np.asarray(self.gravity, float),
            time_step=float(self.time_step),
            pair_index=pair_index,
            num_pairs=len(self.pair_names),
            radius=np.array([*radius, 0.0, 0.0][: nb + 2]),
            has_rims=rims,
            floor_changes=rims | [len(own) > MAX_FLOOR_POINTS or bool((own < ANYHOW).any()) for own in owners[:nb]],
            contact_compliance=compliance,
            joint_compliance=compliance * _JOINT_OVER_CONTACT,
            pusher_force=float(self.pusher_force),
            impact_impulse=masses * _IMPACT_SPEED,
            stabilisation_weight=weight / float(masses.sum()),
            margin=float(self.contact_margin),
            joint_kind=np.array([row[0] for row in rows], np.int64),
            joint_bodies=np.array([row[1] for row in rows], np.int64).reshape(-1, 2),
            joint_anchor=np.array([row[2] for row in rows], float).reshape(-1, 2, 3),
            joint_direction=np.array([row[3] for row in rows], float).reshape(-1, 3),
            joint_rotation=np.array([row[4] for row in rows], float).reshape(-1, 3, 3),
            table=table,
        )

    def joint_rows(self, joint: Joint) -> list[tuple]:
        """Rows of a joint: kind, bodies, anchors, direction and rotation of each."""
        bodies = (self._index(joint.body_A), self._index(joint.body_B))
        anchors = (np.asarray(joint.p_A, float), np.asarray(joint.p_B, float))
        axis_A = np.asarray(joint.axis_A, float) / np.linalg.norm(joint.axis_A)
        axis_B = np.asarray(joint.axis_B, float) / np.linalg.norm(joint.axis_B)
        R_BA = np.asarray(joint.R_BA, float)
        rows: list[tuple] = []
        if joint.kind in ("fixed", "hinge"):
            rows += [(LINEAR, bodies, anchors, direction, R_BA) for direction in np.eye(3)]
        if joint.kind == "no_translation":
            rows.append((LINEAR, bodies, anchors, axis_B, R_BA))
        if joint.kind in ("fixed", "no_rotation"):
            rows += [(ANGULAR_LOCKED, bodies, anchors, direction, R_BA) for direction in np.eye(3)]
        if joint.kind == "hinge":
            first = np.cross(axis_B, np.eye(3)[int(np.argmin(np.abs(axis_B)))])
            first /= np.linalg.norm(first)
            for direction in (first, np.cross(axis_B, first)):
                rows.append((ANGULAR_HINGE, bodies, (axis_A, axis_B), direction, R_BA))
        return rows


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.floating, np.integer)) and math.isfinite(value)


def check_vector(name: str, value: object, unit: str) -> None:
    """Raise ModelError unless a value is three finite numbers."""
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise ModelError(f"{name} is {value}; allowed: three finite numbers, {unit}")


def _check_pieces(name: str, pieces: Sequence[ConvexPiece]) -> None:
    if not len(pieces):
        raise ModelError(f"{name}: got none; allowed: one or more")
    for number, piece in enumerate(pieces):
        extent = float(np.ptp(piece.vertices, axis=0).max()) + 2.0 * piece.radius
        if not _SMALLEST <= extent <= _LARGEST:
            raise ModelError(f"{name}: number {number} is {extent:g} m large; allowed: {_SMALLEST:g} to {_LARGEST:g} m")


def check_mass_properties(name: str, mass: float, inertia: np.ndarray) -> None:
    """Check that mass and inertia belong to some rigid body.

    Args:
        name: name of the body, for the message.
        mass: kg.
        inertia: (3, 3), about the centre of mass, kg m^2.

    Raises:
        ModelError: not finite, mass out of 1e-6 to 1e4 kg, inertia not symmetric, not positive definite, against the
            triangle inequality of principal moments, or that of less than a micrometre.
    """
    if not (_is_number(mass) and LIGHTEST <= mass <= HEAVIEST):
        raise ModelError(f"mass of {name!r} is {mass} kg; allowed: {LIGHTEST:g} to {HEAVIEST:g}")
    inertia = np.asarray(inertia, float)
    if inertia.shape != (3, 3) or not np.all(np.isfinite(inertia)):
        raise ModelError(f"inertia of {name!r} is {inertia.tolist()}; allowed: a finite 3 x 3 matrix, kg m^2")
    scale = float(np.max(np.abs(inertia)))
    if not np.allclose(inertia, inertia.T, rtol=0.0, atol=1e-12 * scale):
        raise ModelError(f"inertia of {name!r} is not symmetric: {inertia.tolist()}")
    moments = np.linalg.eigvalsh(inertia)
    if not moments[0] > 0.0 or moments[0] + moments[1] < moments[2] * (1.0 - 1e-9):
        raise ModelError(
            f"inertia of {name!r} has principal moments {moments.tolist()} kg m^2; allowed: positive, and no two of "
            "them together less than the third"
        )
    if moments[0] < mass * LEAST_GYRATION**2:
        raise ModelError(
            f"inertia of {name!r} has a principal moment of {moments[0]:g} kg m^2; allowed: at least that of "
            f"{mass:g} kg at {LEAST_GYRATION:g} m"
        )
