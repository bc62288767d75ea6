# SPDX-License-Identifier: MIT
"""The six objects that are pushed: their meshes in colours, and the exact convex pieces that engines get."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.next_push.jug import jug_pieces, scanned_jug
from pinwm_drake.files import prepare_folder
from pinwm_drake.geometry.convex import hollow_mug
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import object_model
from pinwm_drake.models.paint import Paint, painted

_L = np.array([[0, 0], [0.12, 0], [0.12, 0.04], [0.04, 0.04], [0.04, 0.10], [0, 0.10]])  # m, outline
_L_HEIGHT, _PRISM_RADIUS, _PRISM_HEIGHT = 0.04, 0.04, 0.05  # m
_T_BOXES = (((0.10, 0.04, 0.05), (0.0, -0.035, 0.0)), ((0.04, 0.10, 0.05), (0.0, 0.035, 0.0)))
_L_BOXES = (((0.12, 0.04, 0.04), (0.06, 0.02, 0.02)), ((0.04, 0.06, 0.04), (0.02, 0.07, 0.02)))
_CUBE_BOXES = (((0.06, 0.06, 0.06), (0.0, 0.0, 0.0)),)
_MUG_SEGMENTS = 64
Box = tuple[tuple[float, float, float], tuple[float, float, float]]
Meshed = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Thing:
    """An object that is pushed; z of O is up when it stands.

    Attributes:
        name: One of `OBJECTS`.
        mesh_path: Watertight mesh, m, frame O; convex pieces stand in `pieces` beside it.
        visual_path: The same surface in colours.
        boxes: Size and middle [m, frame O] of the boxes that it is made of; none where it is not.
        hulls: Points (n, 3) m, frame O, whose convex hulls are its pieces; for every object.
    """

    name: str
    mesh_path: Path
    visual_path: Path
    boxes: tuple[Box, ...]
    hulls: tuple[np.ndarray, ...]

    def mesh(self) -> trimesh.Trimesh:
        """Mesh of the object, m, frame O."""
        return load_mesh(self.mesh_path)

    def base_points(self, reach: float = 0.002) -> np.ndarray:
        """Corners (n, 3) m, frame O, of its convex hull that are as near as `reach` [m] to the plane it stands on."""
        corners = np.unique(np.concatenate([self.mesh().convex_hull.vertices]).round(9), axis=0)
        return corners[corners[:, 2] < corners[:, 2].min() + reach]


class StandingAnyhow(Thing):
    """Object that MuJoCo has touch the floor with any corner of its convex hull, not with its base alone."""

    def base_points(self, reach: float = math.inf) -> np.ndarray:
        """Corners (n, 3) m, frame O, of its convex hull."""
        return super().base_points(math.inf)


def make_thing(name: str, folder: Path) -> Thing:
    """Make an object.

    Args:
        name: One of `OBJECTS`.
        folder: Folder of all objects, to whose subfolder `name` it is written where it does not ship.
    """
    boxes, hulls, surface, paint = OBJECTS[name]()
    if surface is None:
        model = object_model({"t": "t_block"}.get(name, name))
        return Thing(name, model.mesh_path, model.visual_path, boxes, tuple(hulls))
    home = prepare_folder(folder / name)
    path = home / f"{name}.obj"
    path.write_text(_obj(name, *surface), encoding="utf-8")
    visual, colours = painted(path, paint)
    (home / f"{name}_visual.obj").write_text(visual, encoding="utf-8")
    (home / f"{name}_visual.mtl").write_text(colours, encoding="utf-8")
    prepare_folder(home / "pieces")
    for k, points in enumerate(hulls):
        hull = trimesh.convex.convex_hull(points)
        text = _obj(f"piece_{k}", np.asarray(hull.vertices), np.asarray(hull.faces))
        (home / "pieces" / f"{name}_{k:02d}.obj").write_text(text, encoding="utf-8")
    return Thing(name, path, home / f"{name}_visual.obj", boxes, tuple(hulls))


Parts = tuple[tuple[Box, ...], list[np.ndarray], Meshed | None, Paint]
_NO_PAINT = Paint(((), (), ()), lambda middle, normal: "grey")


def _prism() -> Parts:
    angles = np.pi / 3 * np.arange(6)
    outline = _PRISM_RADIUS * np.column_stack([np.cos(angles), np.sin(angles)])
    surface = _extruded(outline, 0, 0.0, _PRISM_HEIGHT)
    return (), [surface[0]], surface, _PRISM_PAINT


def _jug() -> Parts:
    surface = scanned_jug()
    return (), jug_pieces(*surface), surface, _JUG_PAINT


OBJECTS: dict[str, Callable[[], Parts]] = {
    "t": lambda: (_T_BOXES, [_box_points(box) for box in _T_BOXES], None, _NO_PAINT),
    "l": lambda: (_L_BOXES, [_box_points(box) for box in _L_BOXES], _extruded(_L, 3, 0.0, _L_HEIGHT), _L_PAINT),
    "prism": _prism,
    "mug": lambda: ((), [piece.vertices for piece in hollow_mug(segments=_MUG_SEGMENTS)], None, _NO_PAINT),
    "cube": lambda: (_CUBE_BOXES, [_box_points(box) for box in _CUBE_BOXES], None, _NO_PAINT),
    "jug": _jug,
}


def _tiles(middle: np.ndarray, normal: np.ndarray) -> str:
    """Colour of a tile: each side has tones of its own, in an order that its turns do not repeat."""
    tones = (
        ("red", "pink", "cream"),
        ("green", "yellow", "black"),
        ("blue", "cyan", "cream"),
        ("purple", "orange", "grey"),
        ("orange", "blue", "cream", "green", "red"),
        ("grey", "black"),
    )
    axis = int(np.argmax(np.abs(normal)))
    side = tones[2 * axis + int(normal[axis] < 0)]
    column, row, layer = np.floor((middle + 1.0) / 0.02).astype(int)
    return side[(2 * column + row + layer) % len(side)]


def _around(middle: np.ndarray, normal: np.ndarray, axis_xy: tuple[float, float], band: float) -> str:
    """Colour by direction from an upright axis [m] and by bands of a height [m]."""
    x, y = middle[:2] - axis_xy
    sector, layer = int(np.floor(8 * (np.arctan2(y, x) + np.pi) / (2 * np.pi))) % 8, int(np.floor(middle[2] / band))
    if normal[2] < -0.8:
        return ("grey", "brown")[sector // 4]
    stripes = ("red", "yellow", "blue", "cream", "green", "orange", "purple", "cyan")
    return stripes[(sector + 3 * layer) % 8]


def _jug_colour(middle: np.ndarray, normal: np.ndarray) -> str:
    if middle[0] > 0.054:  # the handle
        return "black" if middle[2] > 0.05 else "pink"
    return _around(middle, normal, (0.012, -0.007), 0.024)


_STEPS = tuple(0.02 * k for k in range(1, 6))
_L_PAINT = Paint((_STEPS, _STEPS[:4], (0.02,)), _tiles)
_PRISM_PAINT = Paint(
    ((-0.02, 0.0, 0.02), (-0.02, 0.0, 0.02), (0.025,)),
    lambda middle, normal: _around(middle, normal, (0.003, 0.004), 0.025),
)
_JUG_PAINT = Paint(((), (), ()), _jug_colour)


def _box_points(box: Box) -> np.ndarray:
    signs = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)])
    return signs * np.array(box[0]) + np.array(box[1])


def _extruded(outline: np.ndarray, star: int, low: float, high: float) -> Meshed:
    """Prism over a polygon (n, 2) m, counter-clockwise, that its corner number `star` sees all of."""
    n = len(outline)
    corners = np.vstack([np.column_stack([outline, np.full(n, z)]) for z in (low, high)])
    faces = []
    for k in range(n):
        j = (k + 1) % n
        faces += [[k, j, n + j], [k, n + j, n + k]]
        if star not in (k, j):
            faces += [[star, j, k], [n + star, n + k, n + j]]
    return corners, np.array(faces)


def _obj(name: str, corners: np.ndarray, faces: np.ndarray) -> str:
    lines = ["# Metres; frame O.", f"o {name}"]
    lines += [f"v {x + 0.0:.9g} {y + 0.0:.9g} {z + 0.0:.9g}" for x, y, z in corners]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    return "\n".join(lines) + "\n"
