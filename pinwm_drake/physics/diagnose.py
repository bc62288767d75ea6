# SPDX-License-Identifier: MIT
"""Diagnosis of one step: its contacts and the residuals of its solution."""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pinwm_drake.errors import SolverError, StateError
from pinwm_drake.physics.kernels.cone import FULL_STICKS
from pinwm_drake.physics.kernels.recorded import inspect_step
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters, kernel_arrays
from pinwm_drake.physics.state import State, check_tensor


@dataclass(frozen=True, eq=False)
class StepReport:
    """Contacts of one step of one world, and how well their law holds. C contacts."""

    pair: list[str]  # names of the touching pairs, one for each contact
    gap: np.ndarray  # (C,), m
    frame: np.ndarray  # (C, 3, 3), rows nhat_BA_W, t1, t2, world frame
    witness: np.ndarray  # (C, 2, 3), surface points on A and B, world frame, m
    impulse_W: np.ndarray  # (C, 3), impulse on A, world frame, N s
    impulse: np.ndarray  # (C, 3), the same in the contact's frame: normal and two tangential components
    # (C, 3), s = v + eps lambda, relative velocity after the step with gap, restitution and compliance, in the
    # contact's frame, m/s; see `kernels/cone.py`
    slip: np.ndarray
    x: np.ndarray  # (n,), velocities after the step [rad/s; m/s] of all bodies, then joint impulses
    jammed: np.ndarray  # (C,), whether the pusher presses as hard as it can
    lagged: bool  # whether friction has the bound of an iteration before
    iterations: int  # Newton iterations
    momentum_residual: float  # largest entry of M xi' - p - J' lambda, N s or N m s
    # largest negative normal impulse, normal slip or distance into the friction cone, as a positive number
    sign_violation: float
    complementarity: float  # largest |lambda_n s_n| and lambda_t . s_t + mu lambda_n |s_t|, W s


def inspect(
    model: Model, parameters: Parameters, state: State, V_WP: Tensor | None = None, *, world: int = 0
) -> StepReport:
    """Build and solve the step that would follow `state`, without taking it.

    Args:
        model: the scene.
        parameters: theta of W worlds.
        state: state of W worlds.
        V_WP: (W, 6), pusher velocity [rad/s; m/s], world frame; None: at rest.
        world: index of the world.

    Raises:
        StateError, ParameterError: an input does not fit the model.
        SolverError: a number of the solution is not finite.
    """
    state.check(model)
    parameters.check(model)
    W = state.num_worlds
    if not 0 <= world < W:
        raise StateError(f"world {world}; allowed: 0 to {W - 1}")
    V = state.p_WP.new_zeros(W, 6) if V_WP is None else V_WP
    check_tensor("V_WP", V, (W, 6))
    arrays = kernel_arrays(parameters, V[None], (tensor[None] for tensor in state.tensors()))
    used, contacts, system, solver = inspect_step(model.arrays, *arrays, model.contact_rows, world)
    if used < 0:
        raise SolverError(f"world {world}: the contacts have no finite solution")
    C = int(contacts.number[0])
    impulse, mu = solver.lam[:C], contacts.mu[:C]
    slip = solver.v[:C] + system.contact_compliance * impulse
    jammed = solver.mode[:C] >= FULL_STICKS
    slip[jammed, 0] = np.maximum(slip[jammed, 0], 0.0)  # the pusher enters what resists more than it can press
    inside = mu * impulse[:, 0] - np.linalg.norm(impulse[:, 1:], axis=1)
    normal = np.where(jammed, 0.0, impulse[:, 0] * slip[:, 0])
    power = (impulse[:, 1:] * slip[:, 1:]).sum(1) + mu * impulse[:, 0] * np.linalg.norm(slip[:, 1:], axis=1)
    names = model.pair_names
    return StepReport(
        pair=[names[i] for i in contacts.pair[:C]],
        gap=contacts.gap[:C].copy(),
        frame=contacts.frame[:C].copy(),
        witness=contacts.witness[:C].copy(),
        impulse_W=np.einsum("ci,cij->cj", impulse, contacts.frame[:C]),
        impulse=impulse.copy(),
        slip=slip,
        x=solver.x.copy(),
        jammed=jammed,
        lagged=bool(solver.lagged[0]),
        iterations=int(used),
        momentum_residual=float(np.max(np.abs(solver.dx), initial=0.0)),
        sign_violation=float(max(0.0, -min(np.min(v, initial=0.0) for v in (impulse[:, 0], slip[:, 0], inside)))),
        complementarity=float(max(np.max(np.abs(v), initial=0.0) for v in (normal, power))),
    )
