"""Push in Bullet (PyBullet, DIRECT): default solver, a compound of two boxes, no damping, one world.

The pusher is a body of 1000 kg whose velocity is set before every step; the upward part of that velocity
cancels what gravity adds within the step. Bullet multiplies the frictions of the two bodies of a pair: the
block has the pair's, floor and pusher have 1.
"""

import numpy as np
import pybullet

from benchmarks import push
from benchmarks.timing import Case

_PUSHER_MASS = 1000.0  # kg
_GRAVITY = 9.81  # m/s^2


class BulletPush:
    """Push in Bullet, one world in a physics server of its own."""

    def __init__(self, pusher: str) -> None:
        self._start = push.pusher_start(pusher)
        self._velocity = [0.0, -push.SPEED, _GRAVITY * push.TIME_STEP]
        self.client = client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(push.TIME_STEP, physicsClientId=client)
        pybullet.setGravity(0, 0, -_GRAVITY, physicsClientId=client)
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        floor = pybullet.createMultiBody(0, plane, physicsClientId=client)
        boxes = pybullet.createCollisionShapeArray(
            [pybullet.GEOM_BOX, pybullet.GEOM_BOX],
            halfExtents=[(np.array(size) / 2).tolist() for size in (push.BAR_SIZE, push.STEM_SIZE)],
            collisionFramePositions=[push.BAR_CENTER, push.STEM_CENTER],
            physicsClientId=client,
        )
        self.block = pybullet.createMultiBody(push.MASS, boxes, physicsClientId=client)
        tip = pybullet.createCollisionShape(
            getattr(pybullet, f"GEOM_{pusher.upper()}"),
            radius=push.RADIUS,
            height=push.LENGTH,
            physicsClientId=client,
        )
        self.pusher = pybullet.createMultiBody(_PUSHER_MASS, tip, basePosition=self._start, physicsClientId=client)
        still = {"restitution": 0.0, "linearDamping": 0.0, "angularDamping": 0.0, "physicsClientId": client}
        pybullet.changeDynamics(floor, -1, lateralFriction=1.0, **still)
        pybullet.changeDynamics(self.pusher, -1, lateralFriction=1.0, **still)
        pybullet.changeDynamics(
            self.block, -1, lateralFriction=push.FRICTION,
            localInertiaDiagonal=push.block_inertia().tolist(), **still,
        )  # fmt: skip

    def reset(self) -> None:
        """Resets to the start: the block at rest, the pusher touching it."""
        upright, client = [0.0, 0.0, 0.0, 1.0], self.client
        for body, place in ((self.block, (0.0, 0.0, push.BLOCK_HEIGHT)), (self.pusher, self._start)):
            pybullet.resetBasePositionAndOrientation(body, place, upright, physicsClientId=client)
            pybullet.resetBaseVelocity(body, [0.0] * 3, [0.0] * 3, physicsClientId=client)

    def loop(self) -> Case:
        """Loop of one velocity command and one step at a time from Python: Bullet's only way to take many steps."""
        return Case(lambda: _steps(self.client, self.pusher, self._velocity), self.reset, push.STEPS)

    @staticmethod
    def call_overhead() -> Case:
        """Overhead of the loop: the same two calls in a world that holds one body and no contact."""
        client = pybullet.connect(pybullet.DIRECT)
        body = pybullet.createMultiBody(1.0, physicsClientId=client)
        return Case(lambda: _steps(client, body, [0.0] * 3), units=push.STEPS)

    def trace(self) -> dict:
        """Rolls out once, untimed, and reports contacts and the block's final pose.

        Returns:
            contacts: (steps,) number of contact points; pusher_steps: steps with the pusher in contact;
            p (3,) of the block, world frame, metres.
        """
        self.reset()
        contacts, pusher_steps, client = [], 0, self.client
        for _ in range(push.STEPS):
            _steps(client, self.pusher, self._velocity, 1)
            contacts.append(len(pybullet.getContactPoints(physicsClientId=client)))
            touching = pybullet.getContactPoints(self.block, self.pusher, physicsClientId=client)
            pusher_steps += bool(touching)
        p_WB, _ = pybullet.getBasePositionAndOrientation(self.block, physicsClientId=client)
        return {"contacts": contacts, "pusher_steps": pusher_steps, "p": list(p_WB)}


def _steps(client: int, body: int, velocity: list[float], steps: int = push.STEPS) -> None:
    spin = [0.0] * 3
    for _ in range(steps):
        pybullet.resetBaseVelocity(body, velocity, spin, physicsClientId=client)
        pybullet.stepSimulation(physicsClientId=client)
