"""Parts of MuJoCo models that several scenes have in common."""

import numpy as np

from pinwm_drake.geometry.pieces import ConvexPiece

PUSHER_MASS = 1000.0  # kg: a thousand objects, so that pushing hardly slows it


def numbers(values: object) -> str:
    """Numbers as MuJoCo's XML has them."""
    return " ".join(f"{value:.17g}" for value in np.ravel(np.asarray(values, float)))


def mesh_geoms(pieces: list[ConvexPiece]) -> tuple[str, str]:
    """Meshes and geoms of convex pieces; what is a box with the axes of the object becomes one."""
    meshes = [f'<mesh name="m{i}" vertex="{numbers(piece.vertices)}"/>' for i, piece in enumerate(pieces)]
    geoms = []
    for i, piece in enumerate(pieces):
        low, high = piece.vertices.min(0), piece.vertices.max(0)
        ends = np.round(np.stack([low, high]), 12)
        corners = np.unique(np.round(piece.vertices, 12), axis=0)
        shape = f'type="mesh" mesh="m{i}"'
        if len(corners) == 8 and np.all((corners == ends[0]) | (corners == ends[1])):
            shape = f'type="box" pos="{numbers(0.5 * (low + high))}" size="{numbers(0.5 * (high - low))}"'
        geoms.append(f'<geom {shape} contype="3" conaffinity="3"/>')
    return "".join(meshes), "".join(geoms)


def pusher(geom: str, joints: str = "xyz", place: str = "") -> str:
    """Heavy body on slides along axes of the world, which nothing pulls down and which the floor does not touch.

    Args:
        geom: Attributes of its geom.
        joints: Axes of its slides, by which they are named.
        place: Attribute of the body's place; none for the origin.
    """
    slides = "".join(
        f'<joint name="{axis}" type="slide" axis="{numbers(np.eye(3)["xyz".index(axis)])}"/>' for axis in joints
    )
    return f"""<body name="pusher" gravcomp="1" {place}>{slides}
      <inertial pos="0 0 0" mass="{PUSHER_MASS}" diaginertia="1 1 1"/>
      <geom name="pusher" {geom} contype="2" conaffinity="2"/></body>"""
