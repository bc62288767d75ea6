# SPDX-License-Identifier: MIT
"""Diagnosis of one step: its contacts and the residuals of its solutions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor

from pinwm_drake.errors import SolverError, StateError
from pinwm_drake.physics.kernels.cone import FULL_STICKS, OPEN
from pinwm_drake.physics.kernels.dynamics import IMPACT, POSITION, VELOCITY
from pinwm_drake.physics.kernels.recorded import recall_part
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters, kernel_arrays
from pinwm_drake.physics.state import State, check_tensor
from pinwm_drake.physics.stepper import Stepper


@dataclass(frozen=True, eq=False)
class StepReport:
    """Contacts of one step of one world, and how well their law holds in all of its stages. C contacts.

    A step that meets an impact has several parts; the contacts of one follow those of the one before. Gaps, frames and
    witness points are those at a part's start, impulses are sums over its stages.
    """

    pair: list[str]  # names of the touching pairs, one for each contact
    gap: np.ndarray  # (C,), m
    frame: np.ndarray  # (C, 3, 3), rows nhat_BA_W, t1, t2, world frame
    witness: np.ndarray  # (C, 2, 3), surface points on A and B, world frame, m
    impulse_W: np.ndarray  # (C, 3), impulse on A, world frame, N s
    impulse: np.ndarray  # (C, 3), the same in the contact's frame: normal and two tangential components
    # (C, 3), s = v + eps lambda, relative velocity after the part and compliance, in the contact's frame there, m/s;
    # see `kernels/cone.py`
    slip: np.ndarray
    u: np.ndarray  # (n,), velocities with which positions move first [rad/s; m/s] of all bodies, then joint impulses
    x: np.ndarray  # (n,), velocities after the step [rad/s; m/s] of all bodies, then joint impulses
    parts: int  # impacts and parts between them
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
    """Take the step that would follow `state`, and lay it open.

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
    theta, V_P, states = kernel_arrays(parameters, V[None], state.tensors())
    theta, states = (tuple(array[world : world + 1] for array in arrays) for arrays in (theta, states))
    V_P = np.ascontiguousarray(V_P[:, world : world + 1])
    try:
        *_, frames, saved, _ = Stepper(model, num_threads=1).roll(theta, states, V_P, 1, keep=True)
    except SolverError as error:
        raise SolverError(f"world {world}: the contacts have no finite solution") from error
    parts, lengths, hits = int(saved[-1][0]), saved[9][:, 0], saved[13][:, 0]
    errors, found, u = [(0.0, 0.0, 0.0)], [], None
    for s in range(parts):
        end, at = (frames[:5], 1) if s + 1 == parts else (saved[:5], s + 1)
        carried = s > 0 and hits[s - 1] >= 0
        for stage in (IMPACT,) if lengths[s] == 0.0 else (POSITION, VELOCITY):
            _, contacts, system, solver = recall_part(model.arrays, theta, V_P, saved, end, s, at, carried, stage)
            C = int(contacts.number[0])
            errors.append(_errors(C, contacts, system, solver))
            if stage != VELOCITY:
                found.append(_Part([model.pair_names[k] for k in contacts.pair[:C]], contacts, C))
            found[-1].add(contacts, system, solver)
            u = solver.x.copy() if stage == POSITION and u is None else u
    momentum, sign, complementarity = np.max(errors, axis=0)
    assert u is not None
    return StepReport(
        pair=[name for part in found for name in part.pair],
        **{name: np.concatenate([getattr(part, name) for part in found]) for name in _ARRAYS},
        u=u,
        x=solver.x.copy(),
        parts=parts,
        lagged=bool(frames[5][2, 0]),
        iterations=int(frames[5][0, 0]),
        momentum_residual=float(momentum),
        sign_violation=float(sign),
        complementarity=float(complementarity),
    )


_ARRAYS = ("gap", "frame", "witness", "impulse", "impulse_W", "slip", "jammed")


class _Part:
    """Contacts of a part of a step; arrays as in `StepReport`."""

    def __init__(self, pair: list[str], contacts: Any, C: int) -> None:
        self.pair = pair
        self.gap, self.frame, self.witness = (
            array[:C].copy() for array in (contacts.gap, contacts.frame, contacts.witness)
        )
        self.impulse, self.impulse_W, self.slip = np.zeros((3, C, 3))
        self.jammed = np.zeros(C, bool)

    def add(self, contacts: Any, system: Any, solver: Any) -> None:
        """Add a stage that was solved."""
        C = len(self.pair)
        lam = solver.lam[:C]
        self.impulse, self.impulse_W = (
            self.impulse + lam,
            self.impulse_W + np.einsum("ci,cij->cj", lam, contacts.frame[:C]),
        )
        self.slip = solver.v[:C] + system.contact_compliance * lam
        self.jammed |= solver.mode[:C] >= FULL_STICKS


def _errors(C: int, contacts: Any, system: Any, solver: Any) -> tuple[float, float, float]:
    """Momentum residual, sign violation and complementarity of a stage with C contacts; see `StepReport`."""
    lam, mu = solver.lam[:C], contacts.mu[:C]
    slip = solver.v[:C] + system.contact_compliance * lam
    jammed = solver.mode[:C] >= FULL_STICKS
    slip[jammed, 0] = np.maximum(slip[jammed, 0], 0.0)  # the pusher enters what resists more than it can press
    # What is apart and stays so is judged by its gap, which need not close along the normal of the part's start.
    apart = (contacts.closed[:C] == 0) & (solver.mode[:C] == OPEN)
    inside = mu * lam[:, 0] - np.linalg.norm(lam[:, 1:], axis=1)
    normal = np.where(jammed, 0.0, lam[:, 0] * slip[:, 0])
    power = (lam[:, 1:] * slip[:, 1:]).sum(1) + mu * lam[:, 0] * np.linalg.norm(slip[:, 1:], axis=1)
    return (
        float(np.max(np.abs(solver.dx), initial=0.0)),
        float(max(0.0, -min(np.min(v, initial=0.0) for v in (lam[:, 0], slip[~apart, 0], inside)))),
        float(max(np.max(np.abs(v), initial=0.0) for v in (normal, power))),
    )
