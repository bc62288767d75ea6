# SPDX-License-Identifier: MIT
"""Impulses of the contacts along a rollout."""

import numpy as np
from torch import Tensor

from pinwm_drake.errors import SolverError
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import MOST_SPEED, State, Trajectory, check_tensor
from pinwm_drake.physics.stepper import Stepper


def contact_impulses(
    model: Model, parameters: Parameters, record: Trajectory, V_WP: Tensor, *, num_threads: int | None = None
) -> np.ndarray:
    """Impulses that each pair's contacts exchange in every step of a rollout.

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
    V_P = V_WP.detach().numpy()
    states = [getattr(record, name).detach().numpy() for name in State.__dataclass_fields__]
    theta = tuple(np.ascontiguousarray(tensor.detach().numpy()) for tensor in parameters.tensors())
    stepper = Stepper(model, num_threads=num_threads)
    impulses = np.empty((T, W, len(model.pair_names), 3))
    for t in range(T):
        state = tuple(np.ascontiguousarray(array[t]) for array in states)
        try:
            impulses[t] = stepper.impulses(theta, state, np.ascontiguousarray(V_P[t : t + 1]))
        except SolverError as error:
            raise SolverError(f"step {t}: {error}", worlds=error.worlds) from error
    return impulses
