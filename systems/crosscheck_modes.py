"""How object and floor, and object and pusher, touch: not at all, sticking or sliding."""

import numpy as np

from pinwm_drake.systems.contact_forces import FLOOR_PAIR, PUSHER_PAIR, ContactForces

SEPARATED, STICKING, SLIDING = 0, 1, 2
MODES = ("separated", "sticking", "sliding")
PAIRS = (FLOOR_PAIR, PUSHER_PAIR)
_SLOW = 2e-3  # m/s, between the surfaces, up to which they stick


def contact_modes(forces: ContactForces, object_state: np.ndarray, v_WP: np.ndarray) -> tuple[int, int]:
    """The modes of both pairs of world 0.

    Args:
        forces: On the object.
        object_state: (13,), as an engine's port has it.
        v_WP: (3,) m/s, of the pusher.

    Returns:
        Of object and floor, and of object and pusher. A pair sticks when its surfaces move against each other by no
        more than 2 mm/s, on average over the contacts, each weighted by its force.
    """
    p_WO, w_WO, v_WO = object_state[4:7], object_state[7:10], object_state[10:13]
    return _mode(forces, FLOOR_PAIR, p_WO, w_WO, v_WO), _mode(forces, PUSHER_PAIR, p_WO, w_WO, v_WO - v_WP)


def _mode(forces: ContactForces, pair: str, p_WO: np.ndarray, w_WO: np.ndarray, v_W: np.ndarray) -> int:
    """The mode of a pair; v_W is the velocity of O against the other body, which does not turn."""
    mine = (np.array(forces.pairs, dtype=object) == pair) & (forces.worlds == 0)
    weights = np.linalg.norm(forces.f_W[mine], axis=1)
    if not weights.sum() > 0:
        return SEPARATED
    speeds = np.linalg.norm(v_W + np.cross(w_WO, forces.p_WC[mine] - p_WO), axis=1)
    return STICKING if np.average(speeds, weights=weights) <= _SLOW else SLIDING
