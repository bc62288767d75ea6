# SPDX-License-Identifier: MIT
"""Paints the meshes: writes a normal for each face into NAME.obj, and NAME_visual.obj with its colours NAME_visual.mtl.

Run `python -m pinwm_drake.models.paint` after a mesh was changed; large_t.obj is t_block.obj, 1.4 times as large, and
mug_handle.obj is mug.obj with a handle that reaches into its wall.
RenderEngineVtk wants normals, and a camera that is to see which way an object has turned wants colours that its
symmetry does not repeat: cells of the surface, cut along planes of the object frame, have the colours of a fixed table.
The plain mesh stays one closed surface, which the painted one is not.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_ROOT = Path(__file__).resolve().parent

COLOURS = {
    "red": (0.80, 0.16, 0.14),
    "orange": (0.93, 0.53, 0.13),
    "yellow": (0.93, 0.82, 0.20),
    "green": (0.20, 0.58, 0.26),
    "cyan": (0.18, 0.66, 0.70),
    "blue": (0.16, 0.32, 0.72),
    "purple": (0.50, 0.24, 0.60),
    "pink": (0.90, 0.52, 0.62),
    "brown": (0.45, 0.29, 0.18),
    "grey": (0.42, 0.44, 0.47),
    "black": (0.12, 0.12, 0.13),
    "cream": (0.78, 0.72, 0.56),
}

Polygon = np.ndarray  # (n, 3) [m], convex, plane, counter-clockwise seen from outside


@dataclass(frozen=True)
class Paint:
    """Colouring of a mesh: the cells of its surface, and the colour of each.

    Attributes:
        cuts: Places of the planes that cut the surface into cells, for each axis of O [m].
        colour: Function of a cell's middle (3,) [m] and outward normal (3,) that gives the name of its colour.
    """

    cuts: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
    colour: Callable[[np.ndarray, np.ndarray], str]


def _side(normal: np.ndarray) -> int:
    """Return the number, 0 to 5, of the direction +x, -x, +y, -y, +z or -z that a normal is nearest to."""
    axis = int(np.argmax(np.abs(normal)))
    return 2 * axis + int(normal[axis] < 0)


LARGE_T = 1.4  # times the size of the T-block
# Handle of a mug, frame of mug.obj, m: x and z of its outline and of its inside, each counter-clockwise with x to the
# right and z up; of the lower arm, the grip and the upper arm between them; and half its width along y.
_HANDLE = np.array([[0.0393, -0.02], [0.068, -0.02], [0.068, 0.032], [0.0393, 0.032]])
_HANDLE_INSIDE = np.array([[0.0393, -0.011], [0.059, -0.011], [0.059, 0.023], [0.0393, 0.023]])
HANDLE_PARTS = [
    np.array([_HANDLE[a], _HANDLE[b], _HANDLE_INSIDE[b], _HANDLE_INSIDE[a]]) for a, b in ((0, 1), (1, 2), (2, 3))
]
HANDLE_WIDTH = 0.006
# m, frame of mug.obj: centre of mass of a mug of 92.54 cm^3 with this handle.
HANDLE_CENTER = np.array([0.00552434759, 0.0, 0.000578323277])


def _large_t(middle: np.ndarray, normal: np.ndarray) -> str:
    return _t_block(middle / LARGE_T, normal)


def _t_block(middle: np.ndarray, normal: np.ndarray) -> str:
    tones = (
        ("red", "pink"),
        ("green", "yellow"),
        ("blue", "cyan"),
        ("purple", "cream"),
        ("orange", "blue", "cream", "green", "red"),
        ("grey", "black"),
    )[_side(normal)]
    column, row, layer = np.floor((middle + np.array([0.06, 0.055, 0.025])) / [0.02, 0.02, 0.025]).astype(int)
    return tones[(2 * column + row + layer) % len(tones)]


def _cube(middle: np.ndarray, normal: np.ndarray) -> str:
    side = _side(normal)
    base = ("red", "green", "blue", "yellow", "orange", "purple")[side]
    others = np.delete(middle, side // 2)
    # One corner of each face and the middle of one edge tell its rotations by quarter turns apart.
    if others[0] > 0.01 and others[1] > 0.01:
        return "black"
    return "cream" if others[0] < -0.01 and abs(others[1]) < 0.01 else base


def _mug(middle: np.ndarray, normal: np.ndarray) -> str:
    if normal[2] < -0.5:
        return "grey" if middle[0] > 0 else "brown"
    radial = middle[:2] @ normal[:2]
    if radial <= 0 or normal[2] > 0.5:  # inside, or the rim
        return "cream" if middle[0] > 0 else "pink"
    sector = int(np.floor(8 * np.arctan2(middle[1], middle[0]) / (2 * np.pi)))
    band = int(np.floor((middle[2] + 0.0333232104) / 0.0267))
    stripes = ("red", "yellow", "blue", "cream", "green", "orange", "purple", "cyan")
    return stripes[(sector + 3 * band) % 8]


def _mug_handle(middle: np.ndarray, normal: np.ndarray) -> str:
    place = middle + HANDLE_CENTER
    if place[0] > 0.0401:
        return "black" if place[2] > 0.006 else "pink"
    return _mug(place, normal)


_T_ACROSS, _T_ALONG = (-0.04, -0.02, 0.0, 0.02, 0.04), tuple(-0.035 + 0.02 * k for k in range(6))
PAINTS = {
    "t_block": Paint((_T_ACROSS, _T_ALONG, (0.0,)), _t_block),
    "large_t": Paint((tuple(LARGE_T * x for x in _T_ACROSS), tuple(LARGE_T * y for y in _T_ALONG), (0.0,)), _large_t),
    "cube": Paint(((-0.01, 0.01), (-0.01, 0.01), (-0.01, 0.01)), _cube),
    "mug": Paint(((0.0,), (0.0,), (-0.0066, 0.0201)), _mug),
    "mug_handle": Paint(((-HANDLE_CENTER[0],), (0.0,), (-0.0066, 0.006, 0.0201)), _mug_handle),
}


def read_plain(path: Path) -> tuple[list[str], list[str], np.ndarray, np.ndarray]:
    """Parts of a plain OBJ file of triangles.

    Returns:
        Its comments and "o" lines; its "v" lines; corners (n, 3) [m]; faces (m, 3), counted from 0.
    """
    head, vertices, faces = [], [], []
    for line in path.read_text().splitlines():
        if line.startswith(("#", "o ")):
            head.append(line)
        elif line.startswith("v "):
            vertices.append(line)
        elif line.startswith("f "):
            faces.append([int(corner.split("/")[0]) - 1 for corner in line.split()[1:]])
    points = np.array([[float(value) for value in line.split()[1:]] for line in vertices])
    return head, vertices, points, np.array(faces)


def plain_with_normals(path: Path) -> str:
    """Return the text of a plain OBJ file with a normal for each face; corners stay shared."""
    return _plain_text(*read_plain(path))


def enlarged_t(path: Path) -> str:
    """Return the text of large_t.obj from the file of the T-block."""
    _, _, points, faces = read_plain(path)
    points = LARGE_T * points
    head = f"# The T-block, {LARGE_T:g} times as large, by paint.py. Metres; origin at the centre of mass."
    return _plain_text([head, "o large_t"], [f"v {_numbers(point)}" for point in points], points, faces)


def handled_mug(path: Path) -> str:
    """Return the text of mug_handle.obj from the file of the mug: two bodies, one inside the other."""
    _, _, points, faces = read_plain(path)
    # Corners of the handle: outside, then inside, at -y and then at +y.
    outline = np.concatenate([_HANDLE, _HANDLE_INSIDE])
    handle = np.concatenate([np.insert(outline, 1, y, axis=1) for y in (-HANDLE_WIDTH, HANDLE_WIDTH)])
    front = [(a, b, b + 4, a + 4) for a, b in ((0, 1), (1, 2), (2, 3))]
    around = [0, 1, 2, 3, 7, 6, 5, 4]
    sides = [(a, a + 8, b + 8, b) for a, b in zip(around, [*around[1:], 0], strict=True)]
    squares = [*front, *([k + 8 for k in reversed(square)] for square in front), *sides]
    triangles = np.array([(s[0], *s[k : k + 2]) for s in squares for k in (1, 2)])
    head = "# The mug with a handle towards x, by paint.py. Metres; origin at the centre of mass."
    points = np.concatenate([points, handle]) - HANDLE_CENTER
    faces = np.concatenate([faces, triangles + len(points) - len(handle)])
    return _plain_text([head, "o mug_handle"], [f"v {_numbers(point)}" for point in points], points, faces)


def _plain_text(head: list[str], vertices: list[str], points: np.ndarray, faces: np.ndarray) -> str:
    normals = [f"vn {_numbers(normal)}" for normal in _normals(points[faces])]
    names = list(dict.fromkeys(normals))
    number = {name: k for k, name in enumerate(names, start=1)}
    corners = [
        " ".join(f"{corner + 1}//{number[normal]}" for corner in face)
        for face, normal in zip(faces, normals, strict=True)
    ]
    return "\n".join([*head, *vertices, *names, *(f"f {face}" for face in corners)]) + "\n"


def painted(path: Path, paint: Paint) -> tuple[str, str]:
    """Return the texts of the painted OBJ file and of its MTL file."""
    name = path.stem
    _, _, points, faces = read_plain(path)
    groups: dict[str, list[tuple[Polygon, np.ndarray]]] = {}
    for polygon, normal in zip(points[faces], _normals(points[faces]), strict=True):
        for cell in _cut(polygon, paint.cuts):
            groups.setdefault(paint.colour(cell.mean(axis=0), normal), []).append((cell, normal))
    lines = [f"# {name}.obj in colours, by paint.py. Metres; frame of {name}.obj.", f"mtllib {name}_visual.mtl"]
    corners = normals = 0
    for colour in sorted(groups):
        lines.append(f"usemtl {colour}")
        for cell, normal in groups[colour]:
            lines += [f"v {_numbers(corner)}" for corner in cell] + [f"vn {_numbers(normal)}"]
            normals += 1
            for k in range(1, len(cell) - 1):
                lines.append(f"f {' '.join(f'{corners + 1 + j}//{normals}' for j in (0, k, k + 1))}")
            corners += len(cell)
    materials = [
        f"newmtl {colour}\nKd {_numbers(np.array(COLOURS[colour]))}\nKa 0 0 0\nKs 0 0 0\nillum 1\n"
        for colour in sorted(groups)
    ]
    return "\n".join(lines) + "\n", "\n".join(materials)


_MADE: dict[str, Callable[[], str]] = {
    "large_t": lambda: enlarged_t(_ROOT / "t_block/t_block.obj"),
    "mug_handle": lambda: handled_mug(_ROOT / "mug/mug.obj"),
}


def texts() -> dict[Path, str]:
    """Text of every file that this module writes, by path."""
    found = {}
    for name, paint in PAINTS.items():
        path = _ROOT / name / f"{name}.obj"
        made = _MADE.get(name)
        found[path] = plain_with_normals(path) if made is None else made()
        found[path.with_name(f"{name}_visual.obj")], found[path.with_name(f"{name}_visual.mtl")] = painted(path, paint)
    return found


def _normals(triangles: np.ndarray) -> np.ndarray:
    """Return the unit outward normals (n, 3) of triangles (n, 3, 3)."""
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return across / np.linalg.norm(across, axis=1, keepdims=True)


def _cut(polygon: Polygon, cuts: tuple[tuple[float, ...], ...]) -> list[Polygon]:
    """Return a convex polygon cut along planes of the axes."""
    cells = [polygon]
    for axis, places in enumerate(cuts):
        for place in places:
            cells = [part for cell in cells for part in _halves(cell, axis, place)]
    return cells


def _halves(polygon: Polygon, axis: int, place: float) -> list[Polygon]:
    """Return the parts of a convex polygon below and above a plane, without slivers under a micrometre."""
    height = polygon[:, axis] - place
    height[np.abs(height) < 1e-6] = 0
    if (height >= 0).all() or (height <= 0).all():
        return [polygon]
    parts = []
    for sign in (-1, 1):
        corners: list[np.ndarray] = []
        for k in range(len(polygon)):
            here, there = sign * height[k - 1], sign * height[k]
            if here * there < 0:
                corners.append(polygon[k - 1] + here / (here - there) * (polygon[k] - polygon[k - 1]))
            if there >= 0:
                corners.append(polygon[k])
        parts.append(np.array(corners))
    return parts


def _numbers(values: np.ndarray) -> str:
    """Text of numbers with nine digits each; rounding errors of a zero are zero."""
    return " ".join(f"{0.0 if abs(value) < 1e-15 else value:.9g}" for value in values)


if __name__ == "__main__":
    for name in PAINTS:
        (_ROOT / name).mkdir(exist_ok=True)
    for name, made in _MADE.items():
        (_ROOT / name / f"{name}.obj").write_text(made())
    for file, text in texts().items():
        file.write_text(text)
