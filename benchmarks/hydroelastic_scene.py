"""Scene of the study of hydroelastic contact, and the measurements in it."""

import math
import time
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.systems.crosscheck.motion import Motion, SceneRig, unlimited
from pinwm_drake.systems.crosscheck.trials import Trial
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.scenario.schema import Physics, Scenario, Start, Theta
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.scenario.start import Place

_IMPACT_SPEED = 0.2  # m/s
_REST = (0.1, 0.2)  # s, between which an object that was put down creeps


def scene(name: str, friction: float, physics: Physics | None = None) -> Setup:
    """Setup of an object of 1 kg with the same friction on floor and pusher, at any yaw."""
    start, theta = Start(yaw=[-math.pi, math.pi]), Theta(1.0, friction, friction, 0.0)
    return unlimited(make_setup(Scenario(object=name, theta=theta, start=start, physics=physics or Physics())))


@dataclass(frozen=True, eq=False)
class Findings:
    """Measurements of a variant.

    Attributes:
        motions: Motions of the object in the pushes.
        bounce: m/s by which the object leaves a central impact faster than the pusher is.
        sinking: m, into the floor, at rest.
        creep: m/s, at most: put down, or after a push, where it may lean on the pusher.
        cost: Seconds of one core for a simulated second.
    """

    motions: list[Motion]
    bounce: float
    sinking: float
    creep: float
    cost: float


def measure(setup: Setup, engine: str, trials: list[Trial]) -> Findings:
    """Measures a variant: pushes, central impacts and objects that are put down."""
    rig = SceneRig(setup, engine)
    before = time.process_time()
    motions = [rig.run(trial) for trial in trials]
    spent = time.process_time() - before
    lowest = float(load_mesh(setup.twin.mesh_path).bounds[0, 2])
    heights, creep = _put_down(rig, trials[0])
    return Findings(
        motions,
        bounce=_bounce(rig, lowest),
        sinking=setup.twin.floor_height - (heights + lowest),
        creep=max(creep, *(_creep(motion) for motion in motions)),
        cost=spent / sum(motion.t[-1] for motion in motions),
    )


def _creep(motion: Motion) -> float:
    """Speed of creep, m/s, after the object had come to rest."""
    if motion.rest is None or motion.rest + 1 >= len(motion.t):
        return math.nan
    # The first half of that time, in which a speed below 1 mm/s dies down, is left out.
    middle = (motion.rest + len(motion.t) - 1) // 2
    way = np.linalg.norm(motion.p_WO[-1, :2] - motion.p_WO[middle, :2])
    return float(way / max(motion.t[-1] - motion.t[middle], 1e-9))


def _put_down(rig: SceneRig, trial: Trial) -> tuple[float, float]:
    """Height of O at rest, m, and how fast the object creeps, m/s."""
    places = []
    rig.begin(Place(trial.X_WO, trial.push.p_WP))
    for _ in rig.advance_to(_REST):
        places.append(rig.station.object_pose(rig.simulator.get_context()).translation())
    return float(places[-1][2]), float(np.linalg.norm((places[1] - places[0])[:2]) / (_REST[1] - _REST[0]))


def _bounce(rig: SceneRig, lowest: float) -> float:
    """Speed, m/s, by which the object leaves faster than the pusher that hits it in line with its centre of mass."""
    mesh, radius = load_mesh(rig.setup.twin.mesh_path), rig.setup.twin.pusher.shape.radius
    floor, gap = rig.setup.twin.floor_height, 0.012
    start = np.array([0.0, mesh.bounds[0, 1] - radius - gap, floor - lowest])
    push = StraightPush(start, np.array([0.0, 1.0, 0.0]), _IMPACT_SPEED, 0.05, 10.0)
    rig.begin(Place(RigidTransform([0, 0, floor - lowest]), start), push)
    fastest = 0.0
    for _ in rig.advance_to(np.arange(0.05, 0.15, 5e-4)):
        fastest = max(fastest, rig.evaluate("object_state")[11])
    return float(fastest - _IMPACT_SPEED)
