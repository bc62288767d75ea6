"""Push in MuJoCo: its default solver (Newton, pyramidal cone, condim 3), Euler integration, one world.

The pusher is a body on one frictionless slide joint, of 1000 kg, that starts at the pushing speed: nothing
has to be commanded, so that the whole rollout is a single call, `mj_step(model, data, nstep=320)`, whose loop
is in C. It loses 0.3 per cent of its speed over the rollout. A mocap body costs the same within 3 per cent,
but moves without a velocity, so that MuJoCo's soft contact lags behind it by 5 mm.
"""

import mujoco
import numpy as np

from benchmarks import push
from benchmarks.mujoco_xml import PUSHER_MASS, numbers
from benchmarks.timing import Case


def _xml(pusher: str) -> str:
    bar, stem = np.array(push.BAR_SIZE) / 2, np.array(push.STEM_SIZE) / 2
    size = f"{push.RADIUS}" if pusher == "sphere" else f"{push.RADIUS} {push.LENGTH / 2}"

    # The pusher collides with the block and not with the floor (contype and conaffinity). MuJoCo takes the
    # larger friction of the two geoms, so that all of them have the pair's.
    return f"""<mujoco>
      <option timestep="{push.TIME_STEP:.17g}"/>
      <default><geom friction="{push.FRICTION} 0 0"/></default>
      <worldbody>
        <geom type="plane" size="0 0 1"/>
        <body name="block" pos="0 0 {push.BLOCK_HEIGHT}">
          <freejoint/>
          <inertial pos="0 0 0" mass="{push.MASS}" diaginertia="{numbers(push.block_inertia())}"/>
          <geom type="box" size="{numbers(bar)}" pos="{numbers(push.BAR_CENTER)}" contype="3" conaffinity="3"/>
          <geom type="box" size="{numbers(stem)}" pos="{numbers(push.STEM_CENTER)}" contype="3" conaffinity="3"/>
        </body>
        <body name="pusher" pos="{numbers(push.pusher_start(pusher))}">
          <joint type="slide" axis="0 -1 0"/>
          <inertial pos="0 0 0" mass="{PUSHER_MASS}" diaginertia="1 1 1"/>
          <geom name="pusher" type="{pusher}" size="{size}" contype="2" conaffinity="2"/>
        </body>
      </worldbody>
    </mujoco>"""


class MujocoPush:
    """Push in MuJoCo, one world."""

    def __init__(self, pusher: str) -> None:
        self.model = mujoco.MjModel.from_xml_string(_xml(pusher))
        self.data = mujoco.MjData(self.model)

    def reset(self) -> None:
        """Resets to the start: the block at rest, the pusher at its speed."""
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
        """Rolls out once, untimed, and reports contacts, solver iterations and the block's final pose.

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
