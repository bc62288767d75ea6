# SPDX-License-Identifier: MIT
"""Push in Bullet (PyBullet, DIRECT): default solver, a compound of two boxes, no damping, one world.

The pusher is a body of 1000 kg whose velocity is set before every step; the upward part of that velocity
cancels what gravity adds within the step. Bullet multiplies the frictions of the two bodies of a pair: the
block has the pair's, floor and pusher have 1.
"""

import numpy as np
import pybullet
from pybullet_utils.bullet_client import BulletClient

from benchmarks.scenes import push
from benchmarks.timing import Case

_PUSHER_MASS = 1000.0  # kg
_GRAVITY = 9.81  # m/s^2
STILL = {"restitution": 0.0, "linearDamping": 0.0, "angularDamping": 0.0, "rollingFriction": 0.0}


def bullet_world(time_step: float, **solver: float) -> tuple[BulletClient, int]:
    """Return a physics server of its own with steps [s], settings of the solver, and a floor of friction 1."""
    bullet = BulletClient(pybullet.DIRECT)
    bullet.setGravity(0, 0, -_GRAVITY)
    bullet.setPhysicsEngineParameter(fixedTimeStep=time_step, **solver)
    floor = bullet.createMultiBody(0, bullet.createCollisionShape(pybullet.GEOM_PLANE))
    bullet.changeDynamics(floor, -1, lateralFriction=1.0, **STILL)
    return bullet, floor


def pusher(
    bullet: BulletClient, kind: str, radius: float, length: float, place: list[float], friction: float = 1.0
) -> int:
    """Return a heavy body in a server: a sphere, or an upright capsule or cylinder of a straight length [m]."""
    tip = bullet.createCollisionShape(getattr(pybullet, f"GEOM_{kind.upper()}"), radius=radius, height=length)
    body: int = bullet.createMultiBody(_PUSHER_MASS, tip, basePosition=place)
    bullet.changeDynamics(body, -1, lateralFriction=friction, **STILL)
    return body


class BulletPush:
    """Push in Bullet, one world in a physics server of its own."""

    def __init__(self, kind: str) -> None:
        self._start = push.pusher_start(kind)
        self._velocity = [0.0, -push.SPEED, _GRAVITY * push.TIME_STEP]
        self._bullet, _ = bullet_world(push.TIME_STEP)
        boxes = self._bullet.createCollisionShapeArray(
            [pybullet.GEOM_BOX, pybullet.GEOM_BOX],
            halfExtents=[(np.array(size) / 2).tolist() for size in (push.BAR_SIZE, push.STEM_SIZE)],
            collisionFramePositions=[push.BAR_CENTER, push.STEM_CENTER],
        )
        self.block = self._bullet.createMultiBody(push.MASS, boxes)
        inertia = push.block_inertia().tolist()
        self._bullet.changeDynamics(
            self.block, -1, lateralFriction=push.FRICTION, localInertiaDiagonal=inertia, **STILL
        )
        self.pusher = pusher(self._bullet, kind, push.RADIUS, push.LENGTH, list(self._start))

    def reset(self) -> None:
        """Reset to the start: the block at rest, the pusher touching it."""
        for body, place in ((self.block, (0.0, 0.0, push.BLOCK_HEIGHT)), (self.pusher, self._start)):
            self._bullet.resetBasePositionAndOrientation(body, place, [0.0, 0.0, 0.0, 1.0])
            self._bullet.resetBaseVelocity(body, [0.0] * 3, [0.0] * 3)

    def loop(self) -> Case:
        """Loop of one velocity command and one step at a time from Python: Bullet's only way to take many steps."""
        return Case(lambda: _steps(self._bullet, self.pusher, self._velocity), self.reset, push.STEPS)

    @staticmethod
    def call_overhead() -> Case:
        """Overhead of the loop: the same two calls in a world that holds one body and no contact."""
        bullet = BulletClient(pybullet.DIRECT)
        body = bullet.createMultiBody(1.0)
        return Case(lambda: _steps(bullet, body, [0.0] * 3), units=push.STEPS)

    def trace(self) -> dict:
        """Roll out once, untimed, and report contacts and the block's final pose.

        Returns:
            contacts: (steps,) number of contact points; pusher_steps: steps with the pusher in contact;
            p (3,) of the block, world frame, metres.
        """
        self.reset()
        contacts, pusher_steps = [], 0
        for _ in range(push.STEPS):
            _steps(self._bullet, self.pusher, self._velocity, 1)
            contacts.append(len(self._bullet.getContactPoints()))
            pusher_steps += bool(self._bullet.getContactPoints(self.block, self.pusher))
        p_WB, _ = self._bullet.getBasePositionAndOrientation(self.block)
        return {"contacts": contacts, "pusher_steps": pusher_steps, "p": list(p_WB)}


def _steps(bullet: BulletClient, body: int, velocity: list[float], steps: int = push.STEPS) -> None:
    spin, client = [0.0] * 3, bullet._client  # the timed loop has no Python but the two calls
    for _ in range(steps):
        pybullet.resetBaseVelocity(body, velocity, spin, physicsClientId=client)
        pybullet.stepSimulation(physicsClientId=client)
