# SPDX-License-Identifier: MIT
"""Push in MuJoCo: its default solver (Newton, pyramidal cone, condim 3), Euler integration, one world.

The pusher is a body on one frictionless slide joint, of 1000 kg, that starts at the pushing speed: nothing
has to be commanded, so that the whole rollout is a single call, `mj_step(model, data, nstep=320)`, whose loop
is in C. It loses 0.3 per cent of its speed over the rollout. A mocap body costs the same within 3 per cent,
but moves without a velocity, so that MuJoCo's soft contact lags behind it by 5 mm.
"""

import mujoco
import numpy as np

from benchmarks.scenes import mujoco_xml, push
from benchmarks.scenes.pinwm_scene import block
from benchmarks.timing import Case


class MujocoPush:
    """Push in MuJoCo, one world."""

    def __init__(self, pusher: str) -> None:
        tip = mujoco_xml.pusher(
            pusher, push.RADIUS, push.LENGTH, push.FRICTION, np.array([[0.0, -1.0, 0.0]]), push.pusher_start(pusher)
        )
        solid = push.MASS, np.zeros(3), push.block_inertia()
        self.model = mujoco_xml.poked_model(
            block().pieces, solid, tip, push.TIME_STEP, friction=push.FRICTION, height=push.BLOCK_HEIGHT
        )
        self.data = mujoco.MjData(self.model)

    def reset(self) -> None:
        """Reset to the start: the block at rest, the pusher at its speed."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qvel[6] = push.SPEED

    def c_loop(self) -> Case:
        """All steps in one call, the loop in C: what a step itself costs."""
        return Case(lambda: mujoco.mj_step(self.model, self.data, nstep=push.STEPS), self.reset, push.STEPS)

    def python_loop(self, nstep: int = 1) -> Case:
        """One call a step from Python; with `nstep` 0 nothing is done inside the calls."""

        def run() -> None:
            for _ in range(push.STEPS):
                mujoco.mj_step(self.model, self.data, nstep=nstep)

        return Case(run, self.reset, push.STEPS)

    def trace(self) -> dict:
        """Roll out once, untimed, and report contacts, solver iterations and the block's final pose.

        Returns:
            contacts: (steps,) number of contacts; pusher_steps: steps with the pusher in contact;
            iterations: mean number of Newton iterations; p (3,) of the block, world frame, metres.
        """
        self.reset()
        pusher = self.model.geom("pusher").id
        contacts, iterations, pusher_steps = [], [], 0
        for _ in range(push.STEPS):
            mujoco.mj_step(self.model, self.data)
            contacts.append(self.data.ncon)
            iterations.append(int(np.sum(self.data.solver_niter)))
            pusher_steps += bool(np.any(self.data.contact.geom == pusher))
        return {
            "contacts": contacts,
            "pusher_steps": pusher_steps,
            "iterations": float(np.mean(iterations)),
            "p": self.data.qpos[:3].tolist(),
        }
