# SPDX-License-Identifier: MIT
"""Impulses of the contacts along a rollout."""

import numpy as np
from torch import Tensor

from pinwm_drake.errors import SolverError
from pinwm_drake.physics.kernels import recorded
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters, kernel_arrays
from pinwm_drake.physics.state import MOST_SPEED, Trajectory, check_tensor
from pinwm_drake.threads import available, share


def contact_impulses(
    model: Model, parameters: Parameters, record: Trajectory, V_WP: Tensor, *, num_threads: int | None = None
) -> np.ndarray:
    """Impulses that each pair's contacts exchange in every step of a rollout.

    A step that the rollout took in parts is solved as one.

    Args:
        model: the scene.
        parameters: theta of W worlds.
        record: the rollout's frames, T + 1 of them: one for each step.
        V_WP: (T, W, 6), spatial velocity of the pusher in each step, [rad/s; m/s], world frame.
        num_threads: threads, worlds being shared among them; None for one on each core.

    Returns:
        (T, W, num_pairs, 3), sums over the contacts of a pair, on its body A, world frame, N s.

    Raises:
        StateError, ParameterError: an input does not fit the model.
        SolverError: a step has no finite solution; the message names world and step.
    """
    parameters.check(model)
    T, W = record.num_frames - 1, parameters.num_worlds
    check_tensor("V_WP", V_WP, (T, W, 6), MOST_SPEED)
    check_tensor("p_WP", record.p_WP, (T + 1, W, 3))
    frames = (record.q_WB, record.p_WB, record.V_WB, record.q_WP, record.p_WP)
    impulses, status = np.zeros((T, W, len(model.pair_names), 3)), np.zeros(W, np.int64)
    arguments = (model.arrays, *kernel_arrays(parameters, V_WP, frames), impulses, status, model.contact_rows)
    share(recorded.contact_impulses, arguments, W, num_threads or available())
    failed = tuple(np.flatnonzero(status < 0).tolist())
    if failed:
        world = failed[0]
        raise SolverError(f"world {world}, step {-status[world] - 1}: the contacts have no solution", worlds=failed)
    return impulses
