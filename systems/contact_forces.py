"""The forces of contact, in the same form for every engine."""

from dataclasses import dataclass

import numpy as np

FLOOR_PAIR, PUSHER_PAIR = "object-floor", "object-pusher"


@dataclass(frozen=True, eq=False)
class ContactForces:
    """n forces that act on objects.

    Attributes:
        worlds: (n,) int, the world of each; 0 where there is one world only.
        pairs: n times "object-floor" or "object-pusher".
        p_WC: (n, 3) m, where each acts, world.
        f_W: (n, 3) N, on the object, world. In the twin they are of the time step that begins now; in Drake's plants,
            whose ports are sampled, of the last one that was made.
    """

    worlds: np.ndarray
    pairs: tuple[str, ...]
    p_WC: np.ndarray
    f_W: np.ndarray

    @staticmethod
    def none() -> "ContactForces":
        """No forces."""
        return ContactForces(np.zeros(0, np.int64), (), np.zeros((0, 3)), np.zeros((0, 3)))
