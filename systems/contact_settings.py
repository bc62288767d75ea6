"""How stiff and how damped the contacts of Drake's plants are; `push_plant` says what was measured with these."""

from dataclasses import dataclass

from pinwm_drake.systems.contact import dissipation_of, surface_frictions

REFERENCE_SPEED = 0.12  # m/s, of approach, at which restitution is meant

FLOOR_SIDE, FLOOR_DEPTH = 4.0, 0.02  # m
# m, from the origin: an edge of the floor's tetrahedra, which would divide the contact surface, starts in its middle.
FLOOR_MIDDLE = (0.9, 0.35)
FLOOR_MODULUS = 3e7  # Pa, reached half-way down: 3e9 Pa/m
# s/m. More of it brakes a sliding object by the bottom of its front side, which is a micrometre under the floor.
FLOOR_DISSIPATION = 20.0
PUSHER_MODULUS = 1e9  # Pa, at its middle
PUSHER_RESOLUTION = 0.002  # m, edges of its tetrahedra
# Of the object's triangles, for each metre of its mean extent. A face's friction torque is up to 0.9 % too small
# with it (T-block); half of it takes more than twice as long.
LONGEST_EDGE = 0.28

# Point contact, N/m, of a pair: a small sphere on the floor, and a convex piece at the pusher.
FLOOR_STIFFNESS = 1e6
# With much more, "lagged" friction is wrong in impacts: see `push_plant`.
PUSHER_STIFFNESS = 5e4
# m, of the spheres on which an object stands. Those on a face stand out by as much, and the corners' by a tenth.
SUPPORT_RADIUS, CORNER_RADIUS = 1e-5, 1e-6

PUSHER_MASS = 1.0  # kg
DRIVE_STIFFNESS, DRIVE_DAMPING = 1e7, 1e5  # N/m, N s/m


@dataclass(frozen=True)
class Surfaces:
    """Coefficients of Drake's geometries that give the pairs those of theta.

    Attributes:
        friction_object: Coulomb coefficient of the object's surface.
        friction_floor: Of the floor's.
        friction_pusher: Of the pusher's.
        dissipation_floor: Hunt and Crossley's, of floor and object [s/m].
        dissipation_pusher: Of pusher and object [s/m].
    """

    friction_object: float
    friction_floor: float
    friction_pusher: float
    dissipation_floor: float
    dissipation_pusher: float

    @classmethod
    def of_pairs(
        cls,
        friction_floor: float,
        friction_pusher: float,
        restitution_floor: float = 0.0,
        restitution_pusher: float = 0.0,
        reference_speed: float = REFERENCE_SPEED,
    ) -> "Surfaces":
        """The surfaces of pairs with given Coulomb coefficients, and restitutions at a speed of approach [m/s]."""
        mu_object, mu_floor, mu_pusher = surface_frictions(friction_floor, friction_pusher)
        floor = min(dissipation_of(restitution_floor, reference_speed), FLOOR_DISSIPATION)
        return cls(mu_object, mu_floor, mu_pusher, floor, dissipation_of(restitution_pusher, reference_speed))
