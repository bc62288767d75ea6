# SPDX-License-Identifier: MIT
"""Pushes through engines of the station, each until the object rests."""

import dataclasses
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

from pinwm_drake.errors import SolverError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.parallel import Executor
from pinwm_drake.systems.crosscheck.trials import Trial
from pinwm_drake.systems.engines.engine import FLOOR_PAIR, PUSHER_PAIR, ContactForces
from pinwm_drake.systems.pusher.choice import SPEEDS
from pinwm_drake.systems.runs.rest import REST_SPEED, REST_TIME, RestCount
from pinwm_drake.systems.runs.scripted import ScriptedStation
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.sdf.twin import twin_solid
from pinwm_drake.systems.station.station import make_station

_PATIENCE = 3.0  # times as long as an object as fast as the pusher needs to stop
_LONGEST = 10.0  # s, after the pusher has stopped
SEPARATED, STICKING, SLIDING = 0, 1, 2
MODES = ("separated", "sticking", "sliding")
PAIRS = (FLOOR_PAIR, PUSHER_PAIR)
_SLOW = 2e-3  # m/s, between the surfaces, up to which they stick
Cases = dict[str, Setup]
"""Setups of stations by name, whose first word is the engine's."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of object and pusher in one engine during a push, at n times that are one period apart.

    Attributes:
        t: (n,) s, times.
        p_WO: (n, 3) m, world: position of the object's origin O.
        q_WO: (n, 4) wxyz, orientation of the object in the world.
        p_WP: (n, 3) m, world: position of the pusher.
        kinetic: (n,) J, kinetic energy of the object.
        height: (n,) m, world: z of the centre of mass.
        floor: (n,) modes of object and floor, numbered as in `MODES`.
        pusher: (n,) modes of object and pusher.
        stop: Index of the first time at which the pusher has stopped for good.
        rest: Index of the first time from which the object is at rest; None where it never came to that.
        failure: Error of the engine when it gave up; empty where it did not.
    """

    t: np.ndarray
    p_WO: np.ndarray
    q_WO: np.ndarray
    p_WP: np.ndarray
    kinetic: np.ndarray
    height: np.ndarray
    floor: np.ndarray
    pusher: np.ndarray
    stop: int
    rest: int | None
    failure: str


class SceneRig(ScriptedStation):
    """A station with a scripted pusher: push after push through one engine.

    Args:
        setup: The scene, of one world.
        engine: "twin", "hydroelastic" or "point".

    Raises:
        InputError: A mesh cannot be used.
    """

    def __init__(self, setup: Setup, engine: str) -> None:
        self.setup, self.engine = setup, engine
        solid = twin_solid(setup.twin)
        self._mass, self._p_OB, self._inertia = solid.mass, np.asarray(solid.p_OB), np.asarray(solid.inertia)
        self._reach = float(np.linalg.norm(load_mesh(setup.twin.mesh_path).vertices - self._p_OB, axis=1).max())
        super().__init__(make_station(setup, engine))

    def run(self, trial: Trial) -> Motion:
        """Pushes, and waits until the fastest point of the object has been slow for `REST_TIME`."""
        period, push = self.setup.period, trial.push
        stop, rest = int(np.ceil(push.end_time / period)), RestCount(int(np.ceil(REST_TIME / period)))
        braking = self.setup.twin.theta["friction_floor"].value * self.setup.twin.gravity
        # As long as an object may take that is as fast as the pusher, and then some.
        patience = min(REST_TIME + 0.5 + _PATIENCE * push.speed / max(braking, 1e-3), _LONGEST)
        times = period * np.arange(stop + int(patience / period))
        rows: list[dict[str, Any]] = []
        failure = ""
        self.begin(Place(trial.X_WO, push.p_WP), push)
        try:
            for k in self.advance_to(times):
                rows.append(self._sample(rows[-1] if rows else {}))
                if rest.add(k >= stop and rows[-1]["speed"] < REST_SPEED):
                    break
        except (SolverError, RuntimeError) as error:
            failure = f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"
        columns: dict[str, Any] = {name: np.array([row[name] for row in rows]) for name in rows[0] if name != "speed"}
        t = period * np.arange(len(rows))
        first = len(rows) - rest.slow if rest.at_rest else None
        return Motion(t=t, **columns, stop=min(stop, len(rows) - 1), rest=first, failure=failure)

    def _sample(self, before: dict[str, Any]) -> dict[str, Any]:
        """Row of a `Motion` now, and an upper bound of the speed of the object's fastest point, m/s."""
        state, pusher = self.evaluate("object_state"), self.evaluate("pusher_state")
        q_WO, p_WO, w_WO, v_WO = state[:4] / np.linalg.norm(state[:4]), state[4:7], state[7:10], state[10:13]
        R_WO = RotationMatrix(Quaternion(wxyz=q_WO)).matrix()
        arm = R_WO @ self._p_OB
        v_WB, w_O = v_WO + np.cross(w_WO, arm), R_WO.T @ w_WO
        try:
            floor, touching = contact_modes(self.evaluate("contact_forces"), state, pusher[3:])
        except SolverError:
            # No shorter step has a solution either: the next update will say so.
            floor, touching = before.get("floor", SEPARATED), before.get("pusher", SEPARATED)
        return {
            "p_WO": p_WO,
            "q_WO": q_WO,
            "p_WP": pusher[:3],
            "kinetic": 0.5 * (self._mass * v_WB @ v_WB + w_O @ self._inertia @ w_O),
            "height": float((p_WO + arm)[2]),
            "floor": floor,
            "pusher": touching,
            "speed": float(np.linalg.norm(v_WB) + self._reach * np.linalg.norm(w_WO)),
        }


def contact_modes(forces: ContactForces, object_state: np.ndarray, v_WP: np.ndarray) -> tuple[int, int]:
    """Modes of both pairs of world 0.

    Args:
        forces: Contact forces on the object.
        object_state: (13,) q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world.
        v_WP: (3,) m/s, world: velocity of the pusher.

    Returns:
        The modes of object and floor, and of object and pusher. A pair sticks when its surfaces move against each other
        by no more than 2 mm/s, on average over the contacts, each weighted by its force.
    """
    p_WO, w_WO, v_WO = object_state[4:7], object_state[7:10], object_state[10:13]
    return _mode(forces, FLOOR_PAIR, p_WO, w_WO, v_WO), _mode(forces, PUSHER_PAIR, p_WO, w_WO, v_WO - v_WP)


def _mode(forces: ContactForces, pair: str, p_WO: np.ndarray, w_WO: np.ndarray, v_W: np.ndarray) -> int:
    """Mode of a pair; v_W (3,) m/s is the velocity of O against the other body, which does not turn."""
    mine = (np.array(forces.pairs, dtype=object) == pair) & (forces.worlds == 0)
    weights = np.linalg.norm(forces.f_W[mine], axis=1)
    if not weights.sum() > 0:
        return SEPARATED
    speeds = np.linalg.norm(v_W + np.cross(w_WO, forces.p_WC[mine] - p_WO), axis=1)
    return STICKING if np.average(speeds, weights=weights) <= _SLOW else SLIDING


def unlimited(setup: Setup) -> Setup:
    """Return the setup with one world, and a pusher that may go wherever it is told."""
    far = 1e2
    pusher = dataclasses.replace(
        setup.scenario.pusher, max_speed=4 * SPEEDS[1], low=[-far, -far, -far], high=[far, far, far]
    )
    return dataclasses.replace(setup, scenario=dataclasses.replace(setup.scenario, num_worlds=1, pusher=pusher))


_rigs: dict[str, dict[str, SceneRig]] = {}  # of a process: those of the last call, by its name and the engine


def run_trials(
    cases: Cases, trials: Sequence[Trial], *, processes: int | None = 1, report: Callable[[], None] = lambda: None
) -> list[dict[str, Motion]]:
    """Run every push in every engine.

    Args:
        cases: Setups of the engines; see `Cases`.
        trials: The pushes.
        processes: Number of processes that share the pushes, 1 or more, with one thread each; None for one a core, as
            memory allows. Results do not depend on it.
        report: Called after each push.

    Returns:
        For each push the motion in each case, in the order of the trials.

    Raises:
        PinwmError: A station cannot be made.
    """
    # Cases cannot be compared, so that each call has a name of its own.
    run = partial(_run, uuid.uuid4().hex, cases)
    try:
        return Executor(workers=processes, option="--processes").map(run, trials, on_result=lambda *_: report())
    finally:
        _rigs.clear()


def _run(name: str, cases: Cases, trial: Trial) -> dict[str, Motion]:
    if name not in _rigs:
        _rigs.clear()
        _rigs[name] = {case: SceneRig(setup, case.split()[0]) for case, setup in cases.items()}
    return {case: rig.run(trial) for case, rig in _rigs[name].items()}
