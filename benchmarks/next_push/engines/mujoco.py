# SPDX-License-Identifier: MIT
"""MuJoCo as an engine, converged: small steps, stiff contacts, elliptic cones, and no slip left.

The pusher is a body of a tonne on one slide joint along the push, whose place and speed are set before every step: it
is where the push has it, and has the speed that soft contacts have to know. Frictions stand in explicit pairs, so that
no rule mixes them; pusher and floor make none. An object of boxes touches the floor with its boxes; another with points
(spheres of 10 um) at the corners of its convex hull, which are what a polyhedron can touch a plane with: of a mesh
MuJoCo would take three.

What comes out is not a rigid block on its corners: a face that slides rattles by some micrometres, on one or two of its
points at a time, and without friction on the floor it does not. Half the time step changes a push by up to 1.8 mm and
1.8 degrees; a time constant of 0.1 ms instead of 1 ms changes the first push of t_mujoco by 9.5 mm and 13 degrees.
Pokes have hits and need shorter steps. A hit bounces: a critically damped contact gives back exp(-2) of its speed.
"""

from collections.abc import Sequence

import mujoco  # type: ignore[import-untyped]
import numpy as np
import trimesh
from pydrake.math import RigidTransform

from benchmarks.next_push.engines.rollout import GRAVITY, LOG_RATE, EngineScene, Theta, Tip, rigid
from benchmarks.next_push.objects import Thing
from benchmarks.scenes.mujoco_xml import numbers, pusher
from pinwm_drake.geometry.primitive import Primitive

_STEPS_PER_LOG = 17  # 1/4080 s
_POINT_RADIUS = 1e-5  # m
_OPTION = (
    'cone="elliptic" impratio="100" noslip_iterations="10" noslip_tolerance="1e-12" iterations="100" tolerance="1e-12"'
)
_PAIR = 'condim="3" solref="0.001 1"'


class PokedScene(EngineScene):
    """Floor, object and pusher in MuJoCo, the pusher on slide joints.

    Args:
        thing: The object.
        theta: The truth about it.
        X_WO: Its pose at first, at rest.
        tip: The pusher; None for none.
        steps_per_log: Time steps in 1 / `LOG_RATE`.
        acts_as: Primitives of the object. Its cylinders meet the floor in the place of corners; others are left out.
    """

    def __init__(
        self,
        thing: Thing,
        theta: Theta,
        X_WO: RigidTransform,
        tip: Tip | None,
        *,
        steps_per_log: int = _STEPS_PER_LOG,
        acts_as: Sequence[Primitive] = (),
    ) -> None:
        self.dt = 1 / (LOG_RATE * steps_per_log)
        self._start, self._axes = (np.zeros(3), np.zeros((0, 3))) if tip is None else (np.array(tip.p_WP), tip.axes)
        names, geoms, assets, standing = _object_geoms(thing, theta, acts_as)
        J = theta.inertia
        inertia = numbers([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]])
        pairs, body = [_pair("floor", name, theta.friction_floor) for name in standing], ""
        if tip is not None:
            pairs += [_pair("pusher", name, theta.friction_pusher) for name in names]
            body = pusher(tip.shape.kind, tip.shape.radius, tip.shape.length, axes=tip.axes, place=tip.p_WP)
        q, p = X_WO.rotation().ToQuaternion().wxyz(), X_WO.translation()
        self._model = mujoco.MjModel.from_xml_string(f"""<mujoco>
          <compiler balanceinertia="false" boundinertia="0" angle="radian"/>
          <option timestep="{self.dt:.17g}" gravity="0 0 {-GRAVITY}" {_OPTION}><flag multiccd="enable"/></option>
          <default><geom contype="0" conaffinity="0"/></default>
          <asset>{"".join(assets)}</asset>
          <worldbody>
            <geom name="floor" type="plane" size="0 0 1"/>
            <body name="object" pos="{numbers(p)}" quat="{numbers(q)}"><freejoint/>
              <inertial pos="{numbers(theta.p_com)}" mass="{theta.mass:.17g}" fullinertia="{inertia}"/>
              {"".join(geoms)}</body>
            {body}
          </worldbody>
          <contact>{"".join(pairs)}</contact>
        </mujoco>""")
        self._data = mujoco.MjData(self._model)

    def step(self, v_WP: np.ndarray, p_WP: np.ndarray | None = None) -> None:
        """Take a step; see `EngineScene.step`."""
        if p_WP is not None:
            self._data.qpos[7:] = self._axes @ (p_WP - self._start)
        self._data.qvel[6:] = self._axes @ v_WP
        mujoco.mj_step(self._model, self._data)

    @property
    def p_WP(self) -> np.ndarray:
        """Position (3,) m of the pusher, world; 0 without one."""
        return self._start + self._data.qpos[7:] @ self._axes

    @property
    def object_state(self) -> np.ndarray:
        """State (13,); see `EngineScene`."""
        q, v = self._data.qpos[3:7], self._data.qvel
        X_WO = rigid(q, self._data.qpos[:3].copy())
        return np.concatenate(
            [X_WO.rotation().ToQuaternion().wxyz(), X_WO.translation(), X_WO.rotation() @ v[3:6], v[:3]]
        )


def _object_geoms(
    thing: Thing, theta: Theta, acts_as: Sequence[Primitive]
) -> tuple[list[str], list[str], list[str], list[str]]:
    """Names of the object's solid geoms, all its geoms and assets, and the names of those that meet the floor."""
    names, geoms, assets = [], [], []
    for k, (size, middle) in enumerate(thing.boxes):
        names.append(f"part_{k}")
        half = 0.5 * np.array(size)
        geoms.append(f'<geom name="part_{k}" type="box" size="{numbers(half)}" pos="{numbers(middle)}"/>')
    for k, points in enumerate(() if thing.boxes else thing.hulls):
        names.append(f"part_{k}")
        corners = np.asarray(trimesh.convex.convex_hull(points).vertices)
        assets.append(f'<mesh name="mesh_{k}" vertex="{numbers(corners.ravel())}" inertia="convex"/>')
        geoms.append(f'<geom name="part_{k}" type="mesh" mesh="mesh_{k}"/>')
    standing, points = list(names) if thing.boxes else [], np.zeros((0, 3)) if thing.boxes else thing.base_points()
    for k, round_one in enumerate(one for one in acts_as if one.kind == "cylinder"):
        standing.append(f"round_{k}")
        size, place = numbers([round_one.size[0], 0.5 * round_one.size[1]]), numbers(round_one.p)
        form = f'type="cylinder" size="{size}" pos="{place}" quat="{numbers(round_one.q)}"'
        geoms.append(f'<geom name="round_{k}" {form} mass="0"/>')
        points = points[round_one.depth(points) < -round_one.tolerance]
    for k, point in enumerate([*theta.feet, *points]):
        standing.append(f"point_{k}")
        middle = point + np.array([0, 0, _POINT_RADIUS])
        geoms.append(f'<geom name="point_{k}" type="sphere" size="{_POINT_RADIUS}" pos="{numbers(middle)}" mass="0"/>')
    return names, geoms, assets, standing


def _pair(one: str, other: str, friction: float) -> str:
    return f'<pair geom1="{one}" geom2="{other}" friction="{friction:.17g} {friction:.17g} 0 0 0" {_PAIR}/>'
