# SPDX-License-Identifier: MIT
"""The differentiable step x' = g(x, a, theta) and rollouts of it, batched over worlds."""

from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from pinwm_drake.errors import ModelError, SolverError, StateError
from pinwm_drake.physics.kernels import rollout as kernels
from pinwm_drake.physics.kernels import states
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import MOST_SPEED, State, Trajectory, check_tensor
from pinwm_drake.threads import available, share

Arrays = tuple[np.ndarray, ...]

_FEW_CONTACTS = 33  # rows of the contact tables to begin with, one of them to see that there are too many
_FEW_PARTS, _PARTS = 16, 1.0625  # slots for parts of steps to begin with: these, and so many for each step
_JOINT_ERROR = 0.01  # m or rad, of a joint at the start; a step closes it at once


class Stepper:
    """Advances worlds by nonsmooth RATTLE steps with times of impact, and differentiates through them.

    Source: PIN-WM eq. 8-10; see `kernels/step.py`, `kernels/cone.py` and `kernels/adjoint.py`.
    """

    def __init__(
        self, model: Model, backend: Literal["numba", "torch"] = "numba", *, num_threads: int | None = None
    ) -> None:
        """Make a stepper of one model.

        Args:
            model: the scene.
            backend: "numba" runs compiled kernels on the CPU; "torch" runs the dense reference on the device of its
                inputs (this is the path for CUDA).
            num_threads: threads of the numba backend, worlds being shared among them; None for one on each core.

        Raises:
            ModelError: unknown backend, or no thread.
        """
        if backend not in ("numba", "torch"):
            raise ModelError(f"backend is {backend!r}; allowed: 'numba' or 'torch'")
        if num_threads is not None and num_threads < 1:
            raise ModelError(f"num_threads is {num_threads}; allowed: at least 1")
        self.model = model
        self.backend = backend
        self.num_threads = num_threads or available()
        self._rows = min(_FEW_CONTACTS, model.contact_rows)
        self._parts = _PARTS

    def step(self, parameters: Parameters, state: State, V_WP: Tensor | None = None) -> State:
        """Discrete update: one step of all worlds, differentiable in everything it is given.

        Args:
            parameters: theta of W worlds.
            state: state of W worlds.
            V_WP: (W, 6), spatial velocity of the pusher during the step, [rad/s; m/s], world frame; None: at rest.

        Returns:
            The state after the step.

        Raises:
            StateError, ParameterError, ModelError: an input does not fit the model.
            SolverError: a world's state became infinite, or it has too many contacts; the message names world and step.
        """
        W = state.num_worlds
        if V_WP is None:
            V_WP = torch.zeros(W, 6, dtype=torch.float64, device=state.p_WP.device)
        check_tensor("V_WP", V_WP, (W, 6))
        return self.rollout(parameters, state, V_WP[None]).frame(1)

    def rollout(
        self,
        parameters: Parameters,
        state: State,
        V_WP: Tensor,
        *,
        record_every: int = 1,
        on_failure: Literal["raise", "hold"] = "raise",
    ) -> Trajectory:
        """Rollout over a sequence of steps, differentiable in everything it is given.

        Without gradients its memory does not grow with its length (only with the frames it records). With
        gradients it keeps states and modes of contacts of every part of a step, under 0.4 kB per part and world.

        Args:
            parameters: theta of W worlds.
            state: initial state of W worlds.
            V_WP: (T, W, 6), spatial velocity of the pusher in each step, [rad/s; m/s], world frame.
            record_every: steps between recorded frames; divides T.
            on_failure: "raise" a SolverError where a world fails, or "hold" that world in its first state, without
                gradients, and go on with the others; `Trajectory.failed` tells which. Only with backend "numba".

        Returns:
            T / record_every + 1 frames, the first being the initial state.

        Raises:
            StateError, ParameterError, ModelError: an input does not fit the model.
            SolverError: a world's state became infinite, or it has too many contacts; the message names world and step.
        """
        state.check(self.model)
        parameters.check(self.model)
        W = state.num_worlds
        T = len(V_WP) if isinstance(V_WP, Tensor) and V_WP.ndim == 3 else 1
        check_tensor("V_WP", V_WP, (T, W, 6), MOST_SPEED)
        if parameters.num_worlds != W:
            raise StateError(f"parameters of {parameters.num_worlds} worlds for a state of {W}")
        if not isinstance(record_every, int) or record_every < 1 or V_WP.shape[0] % record_every:
            raise StateError(f"record_every is {record_every}; allowed: a divisor of {V_WP.shape[0]} steps")
        if on_failure not in ("raise", "hold") or (on_failure == "hold" and self.backend == "torch"):
            raise StateError(f"on_failure is {on_failure!r}; allowed: 'raise', and with backend 'numba' 'hold'")
        if self.model.joints:
            _check_joints(self.model, state)
        if self.backend == "torch":
            from pinwm_drake.physics.reference import rollout_reference

            return rollout_reference(self.model, parameters, state, V_WP, record_every)
        inputs = (*parameters.tensors(), *state.tensors(), V_WP)
        for tensor in inputs:
            if tensor.device.type != "cpu":
                raise StateError(f"a tensor is on {tensor.device}; allowed: cpu (use backend='torch' elsewhere)")
        # torch leaves `apply` untyped.
        return Trajectory(*_Rollout.apply(self, record_every, on_failure == "hold", *inputs))  # type: ignore[no-untyped-call]

    def roll(
        self,
        theta: Arrays,
        state: Arrays,
        V_WP: np.ndarray,
        record_every: int,
        keep: bool,
        hold: bool = False,
        pairs: int = 0,
    ) -> tuple:
        """Roll out plain arrays, nothing checked: `rollout` with all that the kernels keep.

        Callers that step a hundred thousand times check what they give once: that takes longer than a step of a world.

        Args:
            theta: The arrays of `Parameters.tensors`.
            state: q_WB (W, nb, 4), p_WB (W, nb, 3), V_WB (W, nb, 6), q_WP (W, 4), p_WP (W, 3), as in `State`.
            V_WP: (T, W, 6), spatial velocity of the pusher in each step, [rad/s; m/s], world frame. All arrays are
                float64 and contiguous.
            record_every: As in `rollout`.
            keep: whether to keep what a backward pass needs.
            hold: as `on_failure`.
            pairs: number of pairs whose impulses are summed up; 0 for none.

        Returns:
            The arguments of the kernels: model, theta, V_WP, record_every, frames, saved, given (W, pairs, 3).
        """
        model = self.model
        T, W = V_WP.shape[:2]
        q, p, V, q_P, p_P = state
        rows = self._rows
        while True:
            frames = states.allocate_frames(q, p, V, q_P, p_P, T // record_every + 1)
            saved = states.allocate_saved(_FEW_PARTS + int(self._parts * T) if keep else 0, W, model.num_bodies, rows)
            arguments = (model.arrays, theta, V_WP, record_every, frames, saved, np.zeros((W, pairs, 3)))
            share(kernels.rollout_forward, arguments, W, self.num_threads)
            status = frames[-1][0]
            if (status >= 0).all():
                return arguments
            parts, contacts = status < -kernels.TOO_MANY_PARTS, status < -kernels.TOO_MANY_CONTACTS
            if not parts.any() and (not contacts.any() or rows >= model.contact_rows):
                if not hold:
                    _raise_failure(model, status)
                for frame, first in zip(frames, state, strict=False):
                    frame[:, status < 0] = first[status < 0]
                saved[-1][status < 0] = 0
                return arguments
            # More than there was room for: again, with room for more.
            if parts.any():
                self._parts *= 1.5
            if (contacts & ~parts).any():
                rows = self._rows = min(2 * rows, model.contact_rows)

    def impulses(self, theta: Arrays, states: Arrays, V_WP: np.ndarray) -> np.ndarray:
        """Impulses that each pair's contacts exchange in one step; see `impulses.contact_impulses`.

        Args:
            theta: the arrays of `Parameters.tensors`.
            states: as in `advance`.
            V_WP: (1, W, 6), spatial velocity of the pusher, [rad/s; m/s], world frame.

        Returns:
            (W, num_pairs, 3), on body A of a pair, world frame, N s.
        """
        given: np.ndarray = self.roll(theta, states, V_WP, 1, False, pairs=len(self.model.pair_names))[6]
        return given


def _check_joints(model: Model, state: State) -> None:
    """Raise StateError where the two sides of a joint are far apart at the start."""
    from pinwm_drake.physics.reference_rows import joint_error

    error = joint_error(model, state)
    if float(error.max()) > _JOINT_ERROR:
        world, joint = (int(i) for i in torch.nonzero(error > _JOINT_ERROR)[0])
        one = model.joints[joint]
        raise StateError(
            f"joint {joint} ({one.kind}) of {one.body_A!r} in world {world} is {float(error[world, joint]):.3g} m or "
            f"rad apart; allowed: {_JOINT_ERROR:g}"
        )


def _raise_failure(model: Model, status: np.ndarray) -> None:
    worlds = tuple(np.flatnonzero(status < 0).tolist())
    world = worlds[0]
    code = -int(status[world])
    if code > kernels.TOO_MANY_CONTACTS:
        raise SolverError(
            f"world {world}, step {code - kernels.TOO_MANY_CONTACTS - 1}: more than "
            f"{model.max_contacts} contacts; raise Model(max_contacts=...)",
            worlds=worlds,
        )
    raise SolverError(f"world {world}, step {code - 1}: a number of the solution is not finite", worlds=worlds)


class _Rollout(torch.autograd.Function):
    """Rollout as one node of autograd's graph, once differentiable.

    The kernels' arrays are the tensors' own memory, so that all are saved as autograd wants it: a tensor that is
    changed in place before the backward pass is an error there, and not another gradient.
    """

    @staticmethod
    def forward(ctx: Any, stepper: Stepper, record_every: int, hold: bool, *inputs: Tensor) -> tuple[Tensor, ...]:
        arrays = tuple(_array(tensor) for tensor in inputs)
        needed = any(ctx.needs_input_grad)
        *_, frames, saved, _ = stepper.roll(arrays[:7], arrays[7:12], arrays[12], record_every, needed, hold)
        outputs = tuple(torch.from_numpy(array) for array in frames[:5])
        jams, lagged, early = (torch.from_numpy(row) for row in frames[5][1:])
        failed = torch.from_numpy(frames[5][0] < 0)
        ctx.mark_non_differentiable(jams, lagged, early, failed)
        if needed:
            ctx.save_for_backward(*inputs, *outputs)
            ctx.stepper, ctx.record_every, ctx.kept = stepper, record_every, saved
        return *outputs, jams, lagged, early, failed

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        arrays = tuple(_array(tensor) for tensor in ctx.saved_tensors)
        parameters, V_P, states = arrays[:7], arrays[12], arrays[13:]
        frames = (*states, np.zeros((4, V_P.shape[1]), np.int64))
        arguments = (ctx.stepper.model.arrays, parameters, V_P, ctx.record_every, frames, ctx.kept)
        frame_bars = tuple(_array(gradient) for gradient in gradients[:5])
        bars = tuple(
            np.zeros(shape)
            for shape in (*(array.shape for array in parameters), *(array.shape[1:] for array in states), V_P.shape)
        )
        share(kernels.rollout_backward, (*arguments, frame_bars, bars), V_P.shape[1], ctx.stepper.num_threads)
        if (frames[-1][0] < 0).any():
            worlds = tuple(np.flatnonzero(frames[-1][0] < 0).tolist())
            raise SolverError(f"world {worlds[0]}: the adjoint's matrix is singular", worlds=worlds)
        return (None, None, None, *(torch.from_numpy(bar) for bar in bars))


def _array(tensor: Tensor) -> np.ndarray:
    """Return a tensor's values, its own memory where that is contiguous."""
    array: np.ndarray = np.ascontiguousarray(tensor.detach().numpy())
    return array
