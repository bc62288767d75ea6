# SPDX-License-Identifier: MIT
"""Physics of a twin as a function of plain arrays: the states of W objects and pushers one update later."""

import dataclasses

import numpy as np
import torch

from pinwm_drake.errors import SolverError
from pinwm_drake.physics.diagnose import inspect
from pinwm_drake.physics.model import FLOOR
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Arrays, Stepper
from pinwm_drake.twin.rollout import twin_parameters, twin_scene
from pinwm_drake.twin.twin import Twin

# Where the contacts of a step have no solution that the solvers find, shorter steps meet others.
_HALVINGS = 3


class WorldPhysics:
    """Physics of W worlds of a twin; without state of its own, so that the same input gives the same output.

    An object's state (13) is q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s] at O, in the world frame; pushers do not
    turn. `theta` are the tensors of `Parameters` as arrays, float64, checked.

    Args:
        twin: Geometry and settings.
        q_WO: (4,) wxyz: orientation of the lying object, which tells the face that carries it.
        steps: Number of time steps in one update, 1 or more.

    Attributes:
        scene: The twin's physics model.
        retries: Number of times that a world had to take shorter steps so far; a statistic, on which nothing depends.

    Raises:
        InputError: A mesh cannot be used.
    """

    def __init__(self, twin: Twin, q_WO: np.ndarray, steps: int) -> None:
        self.scene = twin_scene(twin, torch.as_tensor(q_WO, dtype=torch.float64))
        self.steps = steps
        self.retries = 0
        self._nominal = twin_parameters(twin, self.scene)
        self._p_OB = self.scene.p_OB.numpy()
        self._steppers = [Stepper(self.scene.model)]
        self._by_pusher = np.array([not name.endswith(FLOOR) for name in self.scene.model.pair_names])

    def parameters(self, num_worlds: int) -> Parameters:
        """Return the twin's theta, for all worlds."""
        return self._nominal.expand(num_worlds)

    def advance(
        self, theta: Arrays, state: np.ndarray, p_WP: np.ndarray, v_WP: np.ndarray, halving: int = 0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Discrete update of the state by the step of `pinwm_drake.physics`, which identification differentiates.

        Args:
            theta: Parameters theta of W worlds.
            state: (W, 13) of the objects.
            p_WP: (W, 3) m, of the pushers.
            v_WP: (W, 3) m/s, of the pushers, held.
            halving: Number of times that time steps are halved at first; worlds that fail take shorter ones.

        Returns:
            The objects' state (W, 13), p_WP (W, 3), and the norms (W,) N s of the impulses from pushers to objects.

        Raises:
            SolverError: The contacts of a world have no solution, nor with shorter steps.
        """
        V_WP = np.zeros((self.steps << halving, len(state), 6))
        V_WP[:, :, 3:] = v_WP
        try:
            *_, frames, _, given = self._stepper(halving).roll(
                theta, self._at_B(theta[4], state, p_WP), V_WP, len(V_WP), keep=False, pairs=len(self._by_pusher)
            )
        except SolverError as error:
            if halving == _HALVINGS:
                raise
            after, p_WP_after, impulse = np.empty_like(state), np.empty_like(p_WP), np.empty(len(state))
            failed = np.isin(np.arange(len(state)), error.worlds)
            self.retries += int(failed.sum())
            for part, again in ((failed, halving + 1), (~failed, halving)):
                if part.any():
                    some = tuple([values[part] for values in theta])
                    try:
                        after[part], p_WP_after[part], impulse[part] = self.advance(
                            some, state[part], p_WP[part], v_WP[part], again
                        )
                    except SolverError as last:
                        # Counted within the part.
                        worlds = tuple(np.flatnonzero(part)[list(last.worlds)].tolist())
                        raise SolverError(f"{last} (worlds {worlds} of all)", worlds=worlds) from last
            return after, p_WP_after, impulse
        q, p, V, _, p_P = (frame[1] for frame in frames[:5])
        after = np.concatenate([q[:, 0], p[:, 0], V[:, 0]], axis=1)
        impulse = np.linalg.norm(given[:, self._by_pusher].sum(1), axis=1)
        return self._moved(after, theta[4], -1.0), p_P, impulse

    def _moved(self, state: np.ndarray, center: np.ndarray, way: float) -> np.ndarray:
        """States (W, 13) at the centre of mass B instead of O (way 1), or back (way -1); `center` of `Parameters`."""
        p_OB = self._p_OB + center[:, 0]
        return _moved(state, way * p_OB) if np.abs(p_OB).max() > 1e-12 else state

    def _at_B(self, center: np.ndarray, state: np.ndarray, p_WP: np.ndarray) -> Arrays:
        """Arrays of `physics.State`, whose bodies have their origin at the centre of mass B."""
        state = self._moved(state, center, 1.0)
        q_WP = np.zeros((len(state), 4))
        q_WP[:, 0] = 1.0
        return state[:, None, :4], state[:, None, 4:7], state[:, None, 7:], q_WP, p_WP

    def _stepper(self, halving: int) -> Stepper:
        while len(self._steppers) <= halving:
            last = self._steppers[-1].model
            self._steppers.append(Stepper(dataclasses.replace(last, time_step=0.5 * last.time_step)))
        return self._steppers[halving]

    def forces(
        self, parameters: Parameters, state: np.ndarray, p_WP: np.ndarray, v_WP: np.ndarray, world: int
    ) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Contact forces of the step that begins at a state.

        Args:
            parameters: theta of W worlds.
            state: (W, 13) of the objects.
            p_WP: (W, 3) m.
            v_WP: (W, 3) m/s.
            world: Number of the world.

        Returns:
            n pair names, p_WC (n, 3) m, and f_W (n, 3) N on the object, of contacts that bear a load.

        Raises:
            SolverError: The contacts have no solution, nor with shorter steps.
        """
        V_WP = torch.zeros(len(state), 6, dtype=torch.float64)
        V_WP[:, 3:] = torch.from_numpy(v_WP.copy())
        arrays = (torch.from_numpy(values.copy()) for values in self._at_B(parameters.center.numpy(), state, p_WP))
        state_B = State(*arrays)
        for halving in range(_HALVINGS + 1):
            model = self._stepper(halving).model
            try:
                report = inspect(model, parameters, state_B, V_WP, world=world)
                break
            except SolverError:
                if halving == _HALVINGS:
                    raise
        force = report.impulse_W / model.time_step
        loaded = np.flatnonzero((force != 0).any(axis=1))
        return [report.pair[k] for k in loaded], report.witness[loaded].mean(axis=1), force[loaded]


def _moved(state: np.ndarray, p: np.ndarray) -> np.ndarray:
    """States (W, 13) at another point of each body, p (W, 3) m away in the body's frame."""
    u, w = state[:, 1:4], state[:, :1]
    t = 2.0 * np.cross(u, p)
    arm = p + w * t + np.cross(u, t)
    moved = state.copy()
    moved[:, 4:7] += arm
    moved[:, 10:13] += np.cross(state[:, 7:10], arm)
    return moved
