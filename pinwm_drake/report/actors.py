"""Surfaces of a mesh file as they are drawn, in the colours of their materials."""

import warnings
from pathlib import Path

import trimesh

from pinwm_drake.report.scene import Actor

PLAIN = (0.75, 0.16, 0.10)  # linear RGB, of a mesh without colours
_GAMMA = 2.2


def coloured_actors(path: Path) -> list[Actor]:
    """The surfaces of a mesh file, one for each of its materials; of one colour where it has none.

    Args:
        path: The file, m, object frame.

    Returns:
        The surfaces.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        parts = trimesh.load_scene(path, process=False, group_material=True).geometry.values()
    actors = []
    for part in parts:
        material = getattr(part.visual, "material", None)
        colour = PLAIN
        if material is not None and material.name and hasattr(material, "diffuse"):
            red, green, blue = ((float(value) / 255.0) ** _GAMMA for value in material.diffuse[:3])
            colour = (red, green, blue)
        actors.append(Actor.from_mesh(part, colour, smooth=False))
    return actors
