"""The twin's physics as a function of plain arrays: state of W worlds in, state of W worlds out.

A row of a state (23): q_WB (4) wxyz, p_WB (3) m, V_WB (6) [ω; v] rad/s, m/s, q_WP (4), p_WP (3) m, v_WP (3) m/s, all in
the world frame; B is the object's centre of mass, with the axes of O. v_WP is the velocity of the last step.
"""

import dataclasses

import numpy as np
import torch

from pinwm_drake.errors import SolverError
from pinwm_drake.physics import Parameters, State, Stepper, inspect
from pinwm_drake.twin import Twin
from pinwm_drake.twin.rollout import twin_parameters, twin_scene

WIDTH = 23
_Q, _P, _V, _Q_P, _P_P, _V_P = (slice(*ends) for ends in ((0, 4), (4, 7), (7, 13), (13, 17), (17, 20), (20, 23)))
# Where the contacts of a step have no solution that the solvers find, shorter steps meet others.
_HALVINGS = 3


class WorldPhysics:
    """Steps of W worlds of a twin; without state of its own, so that the same input gives the same output.

    Attributes:
        scene: The twin's physics model.
        steps: Of the physics in one update.
        period: Of an update, s.
    """

    def __init__(self, twin: Twin, q_WO: np.ndarray, steps: int, num_threads: int | None = None) -> None:
        """Makes the model.

        Args:
            twin: Geometry and settings; theta is given to `advance`.
            q_WO: (4,) wxyz: how the object lies, which tells the face that carries it.
            steps: Of the physics in one update, 1 or more.
            num_threads: That share the worlds; None for one on each core.

        Raises:
            InputError: A mesh cannot be used.
        """
        self.scene = twin_scene(twin, torch.as_tensor(q_WO, dtype=torch.float64))
        self.steps = steps
        self.period = steps * twin.time_step
        self._nominal = twin_parameters(twin, self.scene)
        self._p_OB = self.scene.p_OB.numpy()
        self._offset = bool(np.abs(self._p_OB).max() > 1e-12)
        self._steppers = [Stepper(self.scene.model, num_threads=num_threads)]

    def parameters(self, num_worlds: int) -> Parameters:
        """The twin's theta, for all worlds."""
        return self._nominal.expand(num_worlds)

    def advance(self, parameters: Parameters, x: np.ndarray, v_WP: np.ndarray) -> np.ndarray:
        """The state one update later: the step of `pinwm_drake.physics`, which identification differentiates.

        Args:
            parameters: theta of W worlds, checked.
            x: (W, 23).
            v_WP: (W, 3) m/s, of the pusher, held.

        Returns:
            (W, 23).

        Raises:
            SolverError: The contacts of a world have no solution, nor with shorter steps.
        """
        return self._advance(parameters, x, v_WP, 0)

    def _advance(self, parameters: Parameters, x: np.ndarray, v_WP: np.ndarray, halving: int) -> np.ndarray:
        """With steps of 2^-halving times the length."""
        W = len(x)
        V_WP = torch.zeros(self.steps << halving, W, 6, dtype=torch.float64)
        V_WP[:, :, 3:] = torch.from_numpy(v_WP)
        try:
            end = self._stepper(halving).advance(parameters, _state(x), V_WP)
        except SolverError as error:
            if halving == _HALVINGS:
                raise
            after = np.empty_like(x)
            failed = np.isin(np.arange(W), error.worlds)
            for part, again in ((failed, halving + 1), (~failed, halving)):
                if part.any():
                    after[part] = self._advance(_select(parameters, part), x[part], v_WP[part], again)
            return after
        after = np.empty_like(x)
        after[:, _Q], after[:, _P], after[:, _V] = end.q_WB[:, 0], end.p_WB[:, 0], end.V_WB[:, 0]
        after[:, _Q_P], after[:, _P_P], after[:, _V_P] = end.q_WP, end.p_WP, v_WP
        return after

    def _stepper(self, halving: int) -> Stepper:
        while len(self._steppers) <= halving:
            last = self._steppers[-1]
            model = dataclasses.replace(last.model, time_step=0.5 * last.model.time_step)
            self._steppers.append(Stepper(model, num_threads=last.num_threads))
        return self._steppers[halving]

    def forces(
        self, parameters: Parameters, x: np.ndarray, v_WP: np.ndarray, world: int
    ) -> tuple[list[str], np.ndarray, np.ndarray]:
        """The contact forces of the step that begins at a state.

        Args:
            parameters: theta of W worlds.
            x: (W, 23).
            v_WP: (W, 3) m/s.
            world: Which.

        Returns:
            n pair names, p_WC (n, 3) m, and f_W (n, 3) N on the object, of contacts that bear a load.

        Raises:
            SolverError: The contacts have no solution.
        """
        V_WP = torch.zeros(len(x), 6, dtype=torch.float64)
        V_WP[:, 3:] = torch.from_numpy(v_WP)
        report = inspect(self.scene.model, parameters, _state(x), V_WP, world=world)
        force = report.impulse_W / self.scene.model.time_step
        loaded = np.flatnonzero((force != 0).any(axis=1))
        return [report.pair[k] for k in loaded], report.witness[loaded].mean(axis=1), force[loaded]

    def to_object_state(self, x: np.ndarray) -> np.ndarray:
        """(W, 13): q_WO, p_WO [m], ω_WO [rad/s], v_WO [m/s], at O, of the states x (W, 23)."""
        state = x[:, :13].copy()
        if self._offset:
            arm = _rotate(x[:, _Q], -self._p_OB)  # from B to O
            state[:, 4:7] += arm
            state[:, 10:13] += np.cross(x[:, 7:10], arm)
        return state

    def from_object_state(self, state: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """(W, 23): the states of objects (W, 13) and of pushers at rest at p_WP (W, 3) m, unturned."""
        x = np.zeros((len(state), WIDTH))
        x[:, :13], x[:, 13], x[:, _P_P] = state, 1.0, p_WP
        if self._offset:
            arm = _rotate(state[:, :4], self._p_OB)  # from O to B
            x[:, _P] += arm
            x[:, 10:13] += np.cross(state[:, 7:10], arm)
        return x


def pusher_state(x: np.ndarray) -> np.ndarray:
    """(W, 6): p_WP [m], v_WP [m/s], of the states x (W, 23)."""
    return x[:, 17:23]


def _state(x: np.ndarray) -> State:
    # A Context's arrays cannot be written to, which torch warns of.
    whole = torch.from_numpy(x if x.flags.writeable else x.copy())
    return State(whole[:, None, _Q], whole[:, None, _P], whole[:, None, _V], whole[:, _Q_P], whole[:, _P_P])


def _select(parameters: Parameters, worlds: np.ndarray) -> Parameters:
    return Parameters(*(getattr(parameters, item.name)[worlds] for item in dataclasses.fields(parameters)))


def _rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors v (3,) turned by quaternions q (W, 4) wxyz: (W, 3)."""
    t = 2.0 * np.cross(q[:, 1:], v)
    return np.asarray(v + q[:, :1] * t + np.cross(q[:, 1:], t))
