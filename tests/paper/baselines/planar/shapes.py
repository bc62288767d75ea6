# SPDX-License-Identifier: MIT
"""Meshes and planar models of simple objects."""

from pathlib import Path

import torch
import trimesh

from pinwm_drake.paper.baselines.planar.body import PlanarBody, make_planar_body
from pinwm_drake.paper.baselines.planar.rollout import PlanarParameters

LEVEL = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
# Of a T, as two boxes that touch: extents and middles, m.
BAR, STEM = ((0.1, 0.04, 0.05), (0.0, -0.035, 0.0)), ((0.04, 0.1, 0.05), (0.0, 0.035, 0.0))


def write_boxes(path: Path, *boxes: tuple[tuple[float, ...], tuple[float, ...]]) -> Path:
    """Writes boxes (extents and middle, m) as the objects of an OBJ file."""
    lines, count = [], 0
    for number, (extents, middle) in enumerate(boxes):
        box = trimesh.creation.box(extents)
        box.apply_translation(middle)
        lines += [f"o part{number}", *("v {:.9f} {:.9f} {:.9f}".format(*corner) for corner in box.vertices)]
        lines += ["f {} {} {}".format(*(face + 1 + count)) for face in box.faces]
        count += len(box.vertices)
    path.write_text("\n".join(lines) + "\n")
    return path


def t_body(folder: Path, *, cells: int = 80) -> PlanarBody:
    """A T, as of the captures."""
    return make_planar_body(write_boxes(folder / "t.obj", BAR, STEM), LEVEL, 0.0, 0.0, cells=cells)


def square_body(folder: Path, *, side: float = 0.08) -> PlanarBody:
    """A square of 81 cells."""
    mesh_path = write_boxes(folder / "box.obj", ((side, side, 0.05), (0.0, 0.0, 0.0)))
    return make_planar_body(mesh_path, LEVEL, 0.0, 0.0, cells=81)


def disc_body(folder: Path, *, radius: float = 0.05) -> PlanarBody:
    """A disc."""
    trimesh.creation.cylinder(radius=radius, height=0.04, sections=48).export(folder / "disc.obj")
    return make_planar_body(folder / "disc.obj", LEVEL, 0.0, 0.0, cells=300)


def even(body: PlanarBody, worlds: int = 1, *, friction: float = 0.2, pusher: float = 0.1) -> PlanarParameters:
    """Objects of 0.7 kg whose cells are all alike."""
    C = len(body.cells)
    return PlanarParameters(
        mass=torch.full((worlds, C), 0.7 / C, dtype=torch.float64),
        friction=torch.full((worlds, C), friction, dtype=torch.float64),
        friction_pusher=torch.full((worlds,), pusher, dtype=torch.float64),
    )


def uneven(body: PlanarBody, worlds: int = 1, *, seed: int = 0) -> PlanarParameters:
    """Objects of 0.7 kg whose cells differ by a few times ten percent."""
    generator = torch.Generator().manual_seed(seed)
    mass, friction = (
        torch.exp(0.4 * torch.randn(worlds, len(body.cells), generator=generator, dtype=torch.float64))
        for _ in range(2)
    )
    pusher = 0.05 + 0.2 * torch.rand(worlds, generator=generator, dtype=torch.float64)
    return PlanarParameters(0.7 * mass / mass.sum(-1, keepdim=True), 0.15 * friction, pusher)
