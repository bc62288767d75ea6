"""Diagnosis of one step: its contacts, its LCP and the residuals of the solution."""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from pinwm_drake.errors import SolverError, StateError
from pinwm_drake.physics.kernels.inspect import inspect_step
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State, check_tensor


@dataclass(frozen=True, eq=False)
class StepReport:
    """Contacts and LCP of one step of one world. C contacts, k friction directions.

    Attributes:
        pair: names of the touching pairs, one for each contact.
        gap: (C,), m.
        frame: (C, 3, 3), rows nhat_BA_W, t1, t2, world frame.
        witness: (C, 2, 3), surface points on A and B, world frame, m.
        impulse_W: (C, 3), impulse on A, world frame, N s.
        multipliers: (C, k + 2), lambda of the normal and friction rows, N s, and gamma, m/s.
        slacks: (C, k + 2), left-hand sides of these rows, m/s, and the friction cone's, N s.
        x: (n,), velocities after the step [rad/s; m/s] of all bodies, then joint impulses.
        jammed: (C,), whether the pusher presses as hard as it can.
        iterations: interior-point iterations.
        momentum_residual: largest entry of M xi' - p - J' lambda, N s or N m s.
        sign_violation: largest negative multiplier or slack, as a positive number.
        complementarity: largest |multiplier * slack|, W s.
    """

    pair: list[str]
    gap: np.ndarray
    frame: np.ndarray
    witness: np.ndarray
    impulse_W: np.ndarray
    multipliers: np.ndarray
    slacks: np.ndarray
    x: np.ndarray
    jammed: np.ndarray
    iterations: int
    momentum_residual: float
    sign_violation: float
    complementarity: float


def inspect(
    model: Model, parameters: Parameters, state: State, V_WP: Tensor | None = None, *, world: int = 0
) -> StepReport:
    """Builds and solves the LCP of the step that would follow `state`, without taking it.

    Args:
        model: the scene.
        parameters: theta of W worlds.
        state: state of W worlds.
        V_WP: (W, 6), pusher velocity [rad/s; m/s], world frame; None: at rest.
        world: index of the world.

    Raises:
        StateError, ParameterError: an input does not fit the model.
        SolverError: the LCP found no solution.
    """
    state.check(model)
    parameters.check(model)
    W = state.num_worlds
    if not 0 <= world < W:
        raise StateError(f"world {world}; allowed: 0 to {W - 1}")
    V = state.p_WP.new_zeros(W, 6) if V_WP is None else V_WP
    check_tensor("V_WP", V, (W, 6))
    values = (
        parameters.mass, parameters.inertia, parameters.friction, parameters.restitution,
        state.q_WB, state.p_WB, state.V_WB, state.q_WP, state.p_WP, V,
    )  # fmt: skip
    arrays = [np.ascontiguousarray(value[world].detach().cpu().numpy()) for value in values]
    used, contacts, system, solver = inspect_step(model.arrays, *arrays, model.contact_rows)
    if used < 0:
        raise SolverError(f"world {world}: the contact LCP found no solution")
    C = int(contacts.number[0])
    k = model.friction_directions
    lam, s = solver.lam[:C], solver.s[:C]
    closed = lam[:, :1] > 0.0
    # An open contact's gamma is any bound on its sliding speed; it takes part in nothing.
    s = np.where(closed | (np.arange(k + 2) == 0), s, 0.0)
    jammed = solver.active[:C, 0] == 2
    s[jammed, 0] = np.maximum(s[jammed, 0], 0.0)  # the pusher enters what resists more than it can press
    local = np.stack([lam[:, 0], lam[:, 1 : k + 1] @ system.cosines, lam[:, 1 : k + 1] @ system.sines], -1)
    names = model.pair_names
    return StepReport(
        pair=[names[i] for i in contacts.pair[:C]],
        gap=contacts.gap[:C].copy(),
        frame=contacts.frame[:C].copy(),
        witness=contacts.witness[:C].copy(),
        impulse_W=np.einsum("ci,cij->cj", local, contacts.frame[:C]),
        multipliers=lam.copy(),
        slacks=s.copy(),
        x=solver.x.copy(),
        jammed=jammed,
        iterations=int(used),
        momentum_residual=float(np.max(np.abs(solver.dx), initial=0.0)),
        sign_violation=float(max(0.0, -min(np.min(lam, initial=0.0), np.min(s, initial=0.0)))),
        complementarity=float(np.max(np.abs(lam * s), initial=0.0)),
    )
