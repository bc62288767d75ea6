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

from benchmarks.next_push.engines.rollout import GRAVITY, LOG_RATE, Rollout, Theta, rigid
from benchmarks.next_push.objects import Thing
from benchmarks.next_push.pushes import Push
from pinwm_drake.capture.scene import PusherShape

_STEPS_PER_LOG = 8  # 1/1920 s
_ITERATIONS = 200
_PUSHER_MASS = 1e3  # kg
_STILL = {"restitution": 0.0, "linearDamping": 0.0, "angularDamping": 0.0, "rollingFriction": 0.0}


def roll_out(thing: Thing, theta: Theta, X_WO: RigidTransform, push: Push | None, t: np.ndarray) -> Rollout:
    """Rolls out a push.

    Args:
        thing: The object.
        theta: The truth about it.
        X_WO: Its pose at first, at rest.
        push: What the pusher does; None for no pusher.
        t: (n,) s, increasing from 0, multiples of 1 / `LOG_RATE`.
    """
    client = pybullet.connect(pybullet.DIRECT)
    try:
        tip = None if push is None else (push.shape, push.motion.p_WP)
        return _Scene(client, thing, theta, X_WO, tip).run(np.asarray(t), push)
    finally:
        pybullet.disconnect(client)


class _Scene:
    """Floor, object and pusher in a physics server."""

    def __init__(
        self, client: int, thing: Thing, theta: Theta, X_WO: RigidTransform, tip: tuple[PusherShape, np.ndarray] | None
    ) -> None:
        self.on = {"physicsClientId": client}
        self.dt, self.pusher = 1 / (LOG_RATE * _STEPS_PER_LOG), -1
        pybullet.setGravity(0, 0, -GRAVITY, **self.on)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=self.dt, numSolverIterations=_ITERATIONS, solverResidualThreshold=0.0, **self.on
        )
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, **self.on)
        floor = pybullet.createMultiBody(0, plane, **self.on)
        pybullet.changeDynamics(floor, -1, lateralFriction=1.0, **_STILL, **self.on)
        self.object, self.X_OI = self._add_object(thing, theta)
        self._place(self.object, X_WO @ self.X_OI)
        if tip is not None:
            shape, start = tip
            kind = pybullet.GEOM_SPHERE if shape.kind == "sphere" else pybullet.GEOM_CAPSULE
            form = pybullet.createCollisionShape(kind, radius=shape.radius, height=shape.length, **self.on)
            self.pusher = pybullet.createMultiBody(_PUSHER_MASS, form, basePosition=start.tolist(), **self.on)
            share = theta.friction_pusher / theta.friction_floor
            pybullet.changeDynamics(self.pusher, -1, lateralFriction=share, **_STILL, **self.on)
            pybullet.setCollisionFilterPair(floor, self.pusher, -1, -1, 0, **self.on)

    def _add_object(self, thing: Thing, theta: Theta) -> tuple[int, RigidTransform]:
        """The object, and the pose X_OI of its principal axes in O."""
        moments, R_OI = np.linalg.eigh(theta.inertia)
        R_OI[:, 2] *= np.sign(np.linalg.det(R_OI))
        X_OI = RigidTransform(RotationMatrix(R_OI), theta.p_com)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{thing.name}.obj"
            path.write_text(_hulls_obj(thing, theta), encoding="utf-8")
            shape = pybullet.createCollisionShape(pybullet.GEOM_MESH, fileName=str(path), **self.on)
        body = pybullet.createMultiBody(
            theta.mass,
            shape,
            baseInertialFramePosition=X_OI.translation().tolist(),
            baseInertialFrameOrientation=_xyzw(X_OI),
            **self.on,
        )
        pybullet.changeDynamics(
            body,
            -1,
            lateralFriction=theta.friction_floor,
            localInertiaDiagonal=moments.tolist(),
            **_STILL,
            **self.on,
        )
        return body, X_OI

    def _place(self, body: int, X_WI: RigidTransform) -> None:
        pybullet.resetBasePositionAndOrientation(body, X_WI.translation().tolist(), _xyzw(X_WI), **self.on)
        pybullet.resetBaseVelocity(body, [0.0] * 3, [0.0] * 3, **self.on)

    def step(self, v_WP: np.ndarray) -> None:
        """Takes a step with a velocity (3,) m/s of the pusher, where there is one."""
        if self.pusher >= 0:
            up = np.array([0.0, 0.0, GRAVITY * self.dt])  # what gravity takes within the step
            pybullet.resetBaseVelocity(self.pusher, (v_WP + up).tolist(), [0.0] * 3, **self.on)
        pybullet.stepSimulation(**self.on)

    def pose(self) -> RigidTransform:
        """Pose X_WO of the object."""
        p, (x, y, z, w) = pybullet.getBasePositionAndOrientation(self.object, **self.on)
        return rigid(np.array([w, x, y, z]), p) @ self.X_OI.inverse()

    def velocity(self) -> tuple[np.ndarray, np.ndarray]:
        """Angular velocity [rad/s] of the object and velocity [m/s] of its origin, world."""
        v, w = (np.array(one) for one in pybullet.getBaseVelocity(self.object, **self.on))
        p_WI = np.array(pybullet.getBasePositionAndOrientation(self.object, **self.on)[0])
        return w, v + np.cross(w, self.pose().translation() - p_WI)

    def pusher_place(self) -> np.ndarray:
        """Position (3,) m of the pusher, world; 0 without one."""
        if self.pusher < 0:
            return np.zeros(3)
        return np.array(pybullet.getBasePositionAndOrientation(self.pusher, **self.on)[0])

    def run(self, t: np.ndarray, push: Push | None) -> Rollout:
        """Steps through the times t (n,) s."""
        poses, places, step = [], [], 0
        for time in t:
            for _ in range(round(time / self.dt) - step):
                self.step(np.zeros(3) if push is None else push.motion.average_velocity(step, self.dt))
                step += 1
            poses.append(self.pose())
            places.append(self.pusher_place())
        return Rollout(t, poses, np.array(places))


class PokedScene:
    """Floor, object and a pusher that goes anywhere, in a server of its own; see MuJoCo's."""

    def __init__(self, thing: Thing, theta: Theta, X_WO: RigidTransform, shape: PusherShape, p_WP: np.ndarray) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        self._scene = _Scene(self._client, thing, theta, X_WO, (shape, p_WP))

    def __del__(self) -> None:
        pybullet.disconnect(self._client)

    def advance(self, v_WP: np.ndarray, seconds: float) -> None:
        """Goes on while the pusher has a velocity (3,) m/s, world."""
        for _ in range(round(seconds / self._scene.dt)):
            self._scene.step(v_WP)

    @property
    def p_WP(self) -> np.ndarray:
        """Position (3,) m of the pusher, world."""
        return self._scene.pusher_place()

    @property
    def object_state(self) -> np.ndarray:
        """State (13,): q_WO wxyz, p_WO [m], angular velocity [rad/s] and velocity of the origin [m/s], world."""
        X_WO = self._scene.pose()
        return np.concatenate([X_WO.rotation().ToQuaternion().wxyz(), X_WO.translation(), *self._scene.velocity()])


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
