# SPDX-License-Identifier: MIT
"""Flips of objects that do not ship: a box 1:2:3, a bottle-like cylinder and an L, each lying, to be turned by 90°.

    python -m benchmarks.new_objects OUT
    pinwm train OUT/box.scenario.yaml -o OUT/box_policy --minutes 30

Writes a twin and a scenario for each into OUT. The twins have the true mass and shape, painted surfaces, and the
frictions of `flip_mug`; the scenarios are that of `flip_mug` but for the keys that docs/reference/formats/scenario.md
names for a flip of one's own. The sizes are such that a pusher of 1.25 m/s can turn the objects: larger ones it cannot
(docs/lab-book/2026-11-29-new-objects.md).
"""

import argparse
import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import yaml

from pinwm_drake.models import model_path
from pinwm_drake.models.paint import COLOURS, Paint, painted
from pinwm_drake.systems.scenario.schema import Theta
from pinwm_drake.systems.scenario.setup import given_twin
from pinwm_drake.twin.twin import Twin
from pinwm_drake.twin.write import write_twin

_SCENE = model_path("scenarios/flip_mug.scenario.yaml")


@dataclasses.dataclass(frozen=True)
class NewObject:
    """An object, m, how it lies and which of its axes is to point up."""

    mesh: trimesh.Trimesh
    up: tuple[float, float, float]
    q_WO: tuple[float, float, float, float]  # `up` towards -x, where the pusher is
    rolls: int = 1
    roll_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)


def _prism(outline: list[tuple[float, float]], height: float) -> trimesh.Trimesh:
    """Prism over an outline of two boxes (x0, y0, x1, y1), with its centre of mass at the origin."""
    boxes = [
        trimesh.creation.box(bounds=[[a[0], a[1], 0.0], [b[0], b[1], height]])
        for a, b in zip(outline[::2], outline[1::2], strict=True)
    ]
    return trimesh.boolean.union(boxes, engine="manifold")


_HALF = float(np.sqrt(0.5))
OBJECTS = {
    "box": NewObject(trimesh.creation.box((0.04, 0.08, 0.12)), (0.0, 1.0, 0.0), (0.5, 0.5, -0.5, 0.5)),
    "bottle": NewObject(
        trimesh.creation.cylinder(0.035, 0.1, sections=64), (0.0, 0.0, -1.0), (_HALF, 0.0, _HALF, 0.0), 64
    ),
    "l_block": NewObject(
        _prism([(0.0, 0.0), (0.032, 0.08), (0.032, 0.0), (0.064, 0.032)], 0.04),
        (0.0, 1.0, 0.0),
        (_HALF, 0.0, 0.0, _HALF),
    ),
}


def _colour(middle: np.ndarray, normal: np.ndarray) -> str:
    """A pattern without symmetry: cells of 20 mm have colours by their place and side."""
    side = 2 * int(np.argmax(np.abs(normal))) + int(normal[np.argmax(np.abs(normal))] < 0)
    cell = np.floor((middle + 1.0) / 0.02).astype(int)
    return sorted(COLOURS)[(5 * side + int(cell @ (1, 2, 3))) % len(COLOURS)]


def make_twin(name: str, item: NewObject, folder: Path) -> Twin:
    """Twin of an object with its true mass and shape; the mesh is written into `folder`."""
    mesh = item.mesh.copy()
    mesh.apply_translation(-mesh.center_mass)
    path = folder / f"{name}.obj"
    lines = [f"o {name}", *(f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices)]
    path.write_text("\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in mesh.faces + 1)]) + "\n")
    places = tuple(tuple(np.arange(-0.1, 0.1, 0.02)) for _ in range(3))
    text, materials = painted(path, Paint(places, _colour))  # type: ignore[arg-type]
    visual = path.with_name(f"{name}_visual.obj")
    visual.write_text(text)
    visual.with_suffix(".mtl").write_text(materials)
    theta = Theta(**yaml.safe_load(_SCENE.read_text(encoding="utf-8"))["theta"])
    return given_twin(name, path, visual, theta, {"made by": "benchmarks.new_objects"})


def scenario(name: str, item: NewObject) -> dict[str, Any]:
    """The scenario of `flip_mug` with another object and pose."""
    document: dict[str, Any] = yaml.safe_load(_SCENE.read_text(encoding="utf-8"))
    del document["object"], document["theta"]
    start = document["start"]
    start |= {"q_WO": list(item.q_WO), "rolls": item.rolls, "roll_axis": list(item.roll_axis)}
    return document | {
        "name": f"flip_{name}",
        "twin": name,
        "task": {"name": "flip", "up": list(item.up)},
        "start": start,
    }


def main() -> None:
    """Write twins and scenarios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    out: Path = parser.parse_args().out
    for name, item in OBJECTS.items():
        with tempfile.TemporaryDirectory() as folder:
            write_twin(out / name, make_twin(name, item, Path(folder)))
        path = out / f"{name}.scenario.yaml"
        path.write_text(yaml.safe_dump(scenario(name, item), sort_keys=False), encoding="utf-8")
        print(f"pinwm train {path} -o {out / name}_policy --minutes 30")


if __name__ == "__main__":
    main()
