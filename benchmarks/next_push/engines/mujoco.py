"""MuJoCo as an engine, converged: small steps, stiff contacts, elliptic cones, and no slip left.

The pusher is a body of a tonne on one slide joint along the push, whose place and speed are set before every step: it
is where the push has it, and has the speed that soft contacts have to know. Frictions stand in explicit pairs, so that
no rule mixes them; pusher and floor make none. An object of boxes touches the floor with its boxes; another with points
(spheres of 10 um) at the corners of its convex hull, which are what a polyhedron can touch a plane with: of a mesh
MuJoCo would take three.

What comes out is not a rigid block on its corners: a face that slides rattles by some micrometres, on one or two of its
points at a time, and without friction on the floor it does not. Half the time step changes a push by up to 1.8 mm and
1.8 degrees; a time constant of 0.1 ms instead of 1 ms changes the first push of t_mujoco by 9.5 mm and 13 degrees.
"""

from dataclasses import dataclass

import mujoco  # type: ignore[import-untyped]
import numpy as np
import trimesh
from pydrake.math import RigidTransform

from benchmarks.mujoco_xml import PUSHER_MASS, numbers
from benchmarks.next_push.engines.rollout import GRAVITY, LOG_RATE, Rollout, Theta, rigid
from benchmarks.next_push.objects import Thing
from benchmarks.next_push.pushes import Push
from pinwm_drake.capture.scene import PusherShape

_STEPS_PER_LOG = 17  # 1/4080 s
_POINT_RADIUS = 1e-5  # m
_OPTION = (
    'cone="elliptic" impratio="100" noslip_iterations="10" noslip_tolerance="1e-12" iterations="100" tolerance="1e-12"'
)
_PAIR = 'condim="3" solref="0.001 1"'


def roll_out(thing: Thing, theta: Theta, X_WO: RigidTransform, push: Push | None, t: np.ndarray) -> Rollout:
    """Rolls out a push.

    Args:
        thing: The object.
        theta: The truth about it.
        X_WO: Its pose at first, at rest.
        push: What the pusher does; None for no pusher.
        t: (n,) s, increasing from 0, multiples of 1 / `LOG_RATE`.
    """
    tip = None if push is None else Tip(push.shape, push.motion.p_WP, (push.motion.direction_W,))
    model, data = make_model(thing, theta, X_WO, tip)
    dt = model.opt.timestep
    poses, places = [], []
    step = 0
    for time in t:
        for _ in range(round(time / dt) - step):
            if push is not None:
                here, there = (push.motion.travel(k * dt)[0] for k in (step, step + 1))
                data.qpos[7], data.qvel[6] = here, (there - here) / dt
            mujoco.mj_step(model, data)
            step += 1
        poses.append(_pose(data))
        way = 0.0 if push is None else data.qpos[7]
        places.append(np.zeros(3) if push is None else push.motion.p_WP + way * push.motion.direction_W)
    return Rollout(np.asarray(t), poses, np.array(places))


@dataclass(frozen=True, eq=False)
class Tip:
    """A pusher on slide joints.

    Attributes:
        shape: Its shape, upright.
        p_WP: (3,) m, world: where it is at first.
        axes: Directions (3,) of its joints, world.
    """

    shape: PusherShape
    p_WP: np.ndarray
    axes: tuple[np.ndarray, ...]


class PokedScene:
    """Floor, object and a pusher that goes anywhere, as environments have; it goes on by the pusher's velocities."""

    def __init__(self, thing: Thing, theta: Theta, X_WO: RigidTransform, shape: PusherShape, p_WP: np.ndarray) -> None:
        self._start = np.array(p_WP, float)
        self._model, self._data = make_model(thing, theta, X_WO, Tip(shape, self._start, tuple(np.eye(3))))

    def advance(self, v_WP: np.ndarray, seconds: float) -> None:
        """Goes on while the pusher has a velocity (3,) m/s, world."""
        data, dt = self._data, self._model.opt.timestep
        for _ in range(round(seconds / dt)):
            data.qvel[6:9] = v_WP
            mujoco.mj_step(self._model, data)

    @property
    def p_WP(self) -> np.ndarray:
        """Position (3,) m of the pusher, world."""
        return self._start + self._data.qpos[7:10]

    @property
    def object_state(self) -> np.ndarray:
        """State (13,): q_WO wxyz, p_WO [m], angular velocity [rad/s] and velocity of the origin [m/s], world."""
        X_WO, v = _pose(self._data), self._data.qvel
        q_WO = X_WO.rotation().ToQuaternion().wxyz()
        return np.concatenate([q_WO, X_WO.translation(), X_WO.rotation() @ v[3:6], v[:3]])


def make_model(
    thing: Thing, theta: Theta, X_WO: RigidTransform, tip: Tip | None
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Scene of a push, at its start."""
    q, p = X_WO.rotation().ToQuaternion().wxyz(), X_WO.translation()
    names, geoms, assets, standing = _object_geoms(thing, theta)
    J = theta.inertia
    inertia = numbers([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]])
    pairs = [_pair("floor", name, theta.friction_floor) for name in standing]
    pusher = ""
    if tip is not None:
        shape = tip.shape
        joints = "".join(f'<joint type="slide" axis="{numbers(axis)}"/>' for axis in tip.axes)
        size = f"{shape.radius}" if shape.kind == "sphere" else f"{shape.radius} {shape.length / 2}"
        pairs += [_pair("pusher", name, theta.friction_pusher) for name in names]
        pusher = f"""<body pos="{numbers(tip.p_WP)}" gravcomp="1">{joints}
          <inertial pos="0 0 0" mass="{PUSHER_MASS}" diaginertia="1 1 1"/>
          <geom name="pusher" type="{shape.kind}" size="{size}"/></body>"""
    xml = f"""<mujoco>
      <compiler balanceinertia="false" boundinertia="0" angle="radian"/>
      <option timestep="{1 / (LOG_RATE * _STEPS_PER_LOG):.17g}" gravity="0 0 {-GRAVITY}" {_OPTION}>
        <flag multiccd="enable"/></option>
      <default><geom contype="0" conaffinity="0"/></default>
      <asset>{"".join(assets)}</asset>
      <worldbody>
        <geom name="floor" type="plane" size="0 0 1"/>
        <body name="object" pos="{numbers(p)}" quat="{numbers(q)}"><freejoint/>
          <inertial pos="{numbers(theta.p_com)}" mass="{theta.mass:.17g}" fullinertia="{inertia}"/>
          {"".join(geoms)}</body>
        {pusher}
      </worldbody>
      <contact>{"".join(pairs)}</contact>
    </mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_resetData(model, data)
    return model, data


def _pose(data: mujoco.MjData) -> RigidTransform:
    return rigid(data.qpos[3:7], data.qpos[:3].copy())


def _object_geoms(thing: Thing, theta: Theta) -> tuple[list[str], list[str], list[str], list[str]]:
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
    standing = list(names) if thing.boxes else []
    for k, point in enumerate([*theta.feet, *(() if thing.boxes else thing.base_points())]):
        standing.append(f"point_{k}")
        middle = point + np.array([0, 0, _POINT_RADIUS])
        geoms.append(f'<geom name="point_{k}" type="sphere" size="{_POINT_RADIUS}" pos="{numbers(middle)}" mass="0"/>')
    return names, geoms, assets, standing


def _pair(one: str, other: str, friction: float) -> str:
    return f'<pair geom1="{one}" geom2="{other}" friction="{friction:.17g} {friction:.17g} 0 0 0" {_PAIR}/>'
