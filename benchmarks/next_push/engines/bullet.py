# SPDX-License-Identifier: MIT
"""Bullet as an engine: PyBullet without a window, its own solver, margins as they are.

An object is a compound of convex hulls, read from one OBJ file as `createCollisionShape` does it, each with Bullet's
margin of 1 mm around it: this is what makes Bullet's objects larger than their meshes. The pusher is a body of a tonne
whose velocity is set before every step. Bullet multiplies the frictions of a pair: the object has the floor's.
"""

import tempfile
from pathlib import Path

import numpy as np
import pybullet  # type: ignore[import-not-found]
import trimesh
from pydrake.math import RigidTransform, RotationMatrix

from benchmarks.next_push.engines.rollout import GRAVITY, LOG_RATE, EngineScene, Theta, Tip, rigid
from benchmarks.next_push.objects import Thing
from benchmarks.scenes.bullet_scene import STILL, bullet_world, pusher

_STEPS_PER_LOG = 8  # 1/1920 s
_ITERATIONS = 200


class PokedScene(EngineScene):
    """Floor, object and pusher in a physics server of its own."""

    dt = 1 / (LOG_RATE * _STEPS_PER_LOG)

    def __init__(self, thing: Thing, theta: Theta, X_WO: RigidTransform, tip: Tip | None) -> None:
        self._bullet, floor = bullet_world(self.dt, numSolverIterations=_ITERATIONS, solverResidualThreshold=0.0)
        moments, R_OI = np.linalg.eigh(theta.inertia)  # I: principal axes
        R_OI[:, 2] *= np.sign(np.linalg.det(R_OI))
        self._X_OI = RigidTransform(RotationMatrix(R_OI), theta.p_com)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{thing.name}.obj"
            path.write_text(_hulls_obj(thing, theta), encoding="utf-8")
            form = self._bullet.createCollisionShape(pybullet.GEOM_MESH, fileName=str(path))
        place = {"baseInertialFramePosition": self._X_OI.translation().tolist()}
        self._object = self._bullet.createMultiBody(
            theta.mass, form, baseInertialFrameOrientation=_xyzw(self._X_OI), **place
        )
        friction = {"lateralFriction": theta.friction_floor, "localInertiaDiagonal": moments.tolist()}
        self._bullet.changeDynamics(self._object, -1, **friction, **STILL)
        X_WI = X_WO @ self._X_OI
        self._bullet.resetBasePositionAndOrientation(self._object, X_WI.translation().tolist(), _xyzw(X_WI))
        self._bullet.resetBaseVelocity(self._object, [0.0] * 3, [0.0] * 3)
        self._pusher = -1
        if tip is not None:
            shape, share = tip.shape, theta.friction_pusher / theta.friction_floor
            self._pusher = pusher(self._bullet, shape.kind, shape.radius, shape.length, tip.p_WP.tolist(), share)
            self._bullet.setCollisionFilterPair(floor, self._pusher, -1, -1, 0)

    def step(self, v_WP: np.ndarray, p_WP: np.ndarray | None = None) -> None:
        """Take a step; see `EngineScene.step`."""
        if self._pusher >= 0:
            up = np.array([0.0, 0.0, GRAVITY * self.dt])  # what gravity takes within the step
            self._bullet.resetBaseVelocity(self._pusher, (v_WP + up).tolist(), [0.0] * 3)
        self._bullet.stepSimulation()

    @property
    def p_WP(self) -> np.ndarray:
        """Position (3,) m of the pusher, world; 0 without one."""
        if self._pusher < 0:
            return np.zeros(3)
        return np.array(self._bullet.getBasePositionAndOrientation(self._pusher)[0])

    @property
    def object_state(self) -> np.ndarray:
        """State (13,); see `EngineScene`."""
        p_WI, (x, y, z, w) = self._bullet.getBasePositionAndOrientation(self._object)
        v, spin = (np.array(one) for one in self._bullet.getBaseVelocity(self._object))
        X_WO = rigid(np.array([w, x, y, z]), p_WI) @ self._X_OI.inverse()
        q, p = X_WO.rotation().ToQuaternion().wxyz(), X_WO.translation()
        return np.concatenate([q, p, spin, v + np.cross(spin, p - np.array(p_WI))])


def _hulls_obj(thing: Thing, theta: Theta) -> str:
    """OBJ file of an object's convex pieces, and of small octahedra around its feet, each an object of its own."""
    lines, count = [], 0
    feet = [foot + np.array([0, 0, 1e-3]) + 1e-3 * np.vstack([np.eye(3), -np.eye(3)]) for foot in theta.feet]
    for k, points in enumerate([*thing.hulls, *feet]):
        hull = trimesh.convex.convex_hull(points)
        lines += [f"o piece_{k}", *(f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in hull.vertices)]
        lines += [f"f {a} {b} {c}" for a, b, c in hull.faces + 1 + count]
        count += len(hull.vertices)
    return "\n".join(lines) + "\n"


def _xyzw(X: RigidTransform) -> list[float]:
    w, x, y, z = X.rotation().ToQuaternion().wxyz()
    return [x, y, z, w]
