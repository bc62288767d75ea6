# SPDX-License-Identifier: MIT
"""Parts of MuJoCo models that several scenes have in common."""

from collections.abc import Sequence

import mujoco
import numpy as np

from pinwm_drake.geometry.pieces import ConvexPiece

PUSHER_MASS = 1000.0  # kg: a thousand objects, so that pushing hardly slows it
_EYE = np.eye(3)


def numbers(values: object) -> str:
    """Numbers as MuJoCo's XML has them."""
    return " ".join(f"{value:.17g}" for value in np.ravel(np.asarray(values, float)))


def pusher(
    kind: str,
    radius: float,
    length: float,
    friction: float = 0.0,
    axes: np.ndarray = _EYE,
    place: np.ndarray | tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> str:
    """Heavy body on slides along axes of the world, which nothing pulls down and which the floor does not touch.

    Args:
        kind: sphere, capsule or cylinder; upright.
        radius: m.
        length: m, of its straight part; of no account for a sphere.
        friction: Friction of its geom.
        axes: (n, 3) of its slides, "slide0" and so on.
        place: (3,) m, world: its place at first.
    """
    slides = "".join(f'<joint name="slide{k}" type="slide" axis="{numbers(axis)}"/>' for k, axis in enumerate(axes))
    size = f"{radius}" if kind == "sphere" else f"{radius} {length / 2}"
    held = 'gravcomp="1"' if axes[:, 2].any() else ""
    return f"""<body pos="{numbers(place)}" {held}>{slides}
      <inertial pos="0 0 0" mass="{PUSHER_MASS}" diaginertia="1 1 1"/>
      <geom name="pusher" type="{kind}" size="{size}" friction="{friction} 0 0" contype="2" conaffinity="2"/></body>"""


def poked_model(
    pieces: Sequence[ConvexPiece],
    solid: tuple[float, np.ndarray, np.ndarray],
    tip: str,
    time_step: float,
    *,
    friction: float = 0.0,
    height: float = 0.0,
    option: str = "",
    more: str = "",
) -> mujoco.MjModel:
    """Model of a floor, an object that no geom but floor and pusher gives friction, and a pusher.

    Args:
        pieces: Convex pieces of the object; what is a box with its axes becomes one.
        solid: Its mass [kg], centre of mass (3,) m and moments of inertia (3,) kg m^2 about it.
        tip: The pusher, as `pusher` gives it.
        time_step: s.
        friction: Friction of the floor: MuJoCo takes the larger one of a pair.
        height: m, world: z of the object's frame at first.
        option: Further attributes of MuJoCo's options.
        more: Further elements of the model.
    """
    mass, p_com, moments = solid
    meshes, geoms = "", ""
    for i, piece in enumerate(pieces):
        meshes += f'<mesh name="m{i}" vertex="{numbers(piece.vertices)}"/>'
        low, high = piece.vertices.min(0), piece.vertices.max(0)
        ends, corners = np.round([low, high], 12), np.unique(np.round(piece.vertices, 12), axis=0)
        shape = f'type="mesh" mesh="m{i}"'
        if len(corners) == 8 and np.all((corners == ends[0]) | (corners == ends[1])):
            shape = f'type="box" pos="{numbers(0.5 * (low + high))}" size="{numbers(0.5 * (high - low))}"'
        geoms += f'<geom {shape} contype="3" conaffinity="3"/>'
    return mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="{time_step:.17g}" {option}/>
      <default><geom friction="0 0 0"/></default>
      <asset>{meshes}</asset>
      <worldbody>
        <geom name="floor" type="plane" size="0 0 1" friction="{friction} 0 0"/>
        <body name="object" pos="0 0 {height}"><freejoint/>
          <inertial pos="{numbers(p_com)}" mass="{mass}" diaginertia="{numbers(moments)}"/>
          {geoms}
        </body>
        {tip}
      </worldbody>
      {more}</mujoco>""")
