# SPDX-License-Identifier: MIT
"""Past of a state, in one vector with it: a policy that sees it can find out on the way how its world moves.

After the state stand, for each of the last h actions, the newest first, the state before it and the action. What a
robot knows of the pusher is told alike, with the pusher's position in the place of the state. Where an episode has
just begun, its first state stands for those before, and zeros for the actions.

Source: Peng et al., "Sim-to-real transfer of robotic control with dynamics randomization" (ICRA 2018), whose policies
see past states and actions through a recurrent network, and not as a row of them.
"""

import numpy as np


def history_size(size: int, action_size: int, history: int) -> int:
    """Return the number of components of a vector of some size with those before the last actions, and with these.

    Args:
        size: Number of components of the vector alone.
        action_size: Number of components of an action.
        history: Number h of the last actions.
    """
    return size + history * (size + action_size)


def begun(now: np.ndarray, action_size: int, history: int, past: np.ndarray | None = None) -> np.ndarray:
    """Vectors (W, `history_size`) float32 of episodes that have just begun, of vectors (W, size) alone.

    Args:
        now: (W, size) vectors.
        action_size: Number of components of an action.
        history: Number h of the last actions.
        past: (W, m, action_size) actions before, the newest first, m of h or more; None for zeros.
    """
    actions = np.zeros((len(now), history, action_size)) if past is None else past[:, :history]
    before = np.concatenate([np.repeat(now[:, None], history, axis=1), actions], axis=2)
    return np.concatenate([now, before.reshape(len(now), -1)], axis=1).astype(np.float32)
