# SPDX-License-Identifier: MIT
"""Closed surfaces whatever seams, encodings and polygons a file has, and the line of one that makes no sense."""

import codecs

import numpy as np
import pytest
import trimesh

from pinwm_drake.errors import InputError
from pinwm_drake.geometry.meshes import load_mesh

SIZE = np.array([0.1, 0.06, 0.04])
VOLUME = float(np.prod(SIZE))
BOX = trimesh.creation.box(extents=SIZE)
POINTS = [f"v {x} {y} {z}" for x, y, z in BOX.vertices]
FACES = [f"f {a} {b} {c}" for a, b, c in BOX.faces + 1]


def written(folder, lines, encoding="utf-8", name="box.obj"):
    path = folder / name
    path.write_bytes("\n".join([*lines, ""]).encode(encoding))
    return path


def is_box(path):
    mesh = load_mesh(path)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(VOLUME, rel=1e-6)
    assert len(mesh.vertices) == 8


@pytest.mark.parametrize("head", [[], ["o box"], ["o box", "g side"]])
def test_materials_do_not_open_a_surface(tmp_path, head):
    seams = [line for k, face in enumerate(FACES) for line in (f"usemtl m{k // 4}", face)]
    is_box(written(tmp_path, [*head, *POINTS, *seams]))


def test_objects_that_close_each_other_are_one_body(tmp_path):
    is_box(written(tmp_path, [*POINTS, "o top", *FACES[:5], "o rest", *FACES[5:]]))


def test_texture_seams_of_a_glb_do_not_open_a_surface(tmp_path):
    loose = trimesh.Trimesh(BOX.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    loose.visual = trimesh.visual.TextureVisuals(uv=np.random.default_rng(0).random((36, 2)))
    loose.export(tmp_path / "box.glb")
    is_box(tmp_path / "box.glb")


def test_corners_that_rounding_parts_are_one(tmp_path):
    corners = BOX.triangles.reshape(-1, 3) + np.random.default_rng(1).uniform(-2e-8, 2e-8, (36, 3))
    lines = [f"v {x:.12f} {y:.12f} {z:.12f}" for x, y, z in corners]
    is_box(written(tmp_path, [*lines, *(f"f {k} {k + 1} {k + 2}" for k in range(1, 37, 3))]))


@pytest.mark.parametrize(
    "extra",
    [[FACES[3]], [FACES[3]] * 2, ["f 1 1 2"], ["v 0.05 0.03 0", "v 0.05 0.03 0.01", "f 8 9 10"]],
    ids=["doubled", "three times", "two corners alike", "flat"],
)
def test_a_face_that_bounds_nothing_more_is_left_out(tmp_path, extra):
    is_box(written(tmp_path, [*POINTS, *FACES, *extra]))


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([*FACES, "f " + " ".join(FACES[3].split()[:0:-1])], "a face lies on another"),
        ([*FACES[:-1], "f " + " ".join(FACES[-1].split()[:0:-1])], "faces wound against each other at 3 edges"),
        (FACES[:-1], r"an open surface at 3 edges, the first from \(.*\) to \(.*\) m"),
    ],
    ids=["doubled against", "turned", "open"],
)
def test_what_is_not_closed_says_where(tmp_path, faces, message):
    with pytest.raises(InputError, match=message) as error:
        load_mesh(written(tmp_path, [*POINTS, *faces]))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_text_encodings(tmp_path, encoding):
    # The first line is a corner: a mark before it must not hide it.
    is_box(written(tmp_path, [POINTS[0], "# Stück", *POINTS[1:], "o Stück", *FACES], encoding))


@pytest.mark.parametrize("kind", ["stl_ascii", "off", "ply"])
@pytest.mark.parametrize("mark", [codecs.BOM_UTF8, "utf-16"])
def test_marks_before_other_formats(tmp_path, kind, mark):
    path = tmp_path / f"box.{kind.removesuffix('_ascii')}"
    data = BOX.export(file_type=kind, **({"encoding": "ascii"} if kind == "ply" else {}))
    text = data if isinstance(data, str) else data.decode()
    path.write_bytes(mark + text.encode() if isinstance(mark, bytes) else text.encode(mark))
    is_box(path)


def test_polygons_and_relative_corners(tmp_path):
    # Corners counted back from the line where they stand, each face with its own.
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    corners = [(x, y, z) for x in (0, 0.1) for y in (0, 0.06) for z in (0, 0.04)]
    lines = []
    for quad in quads:
        lines += ["v {} {} {}".format(*corners[k]) for k in quad]
        lines += ["f -4/1/1 -3/1/1 \\", "-2/1/1 -1/1/1"]
    is_box(written(tmp_path, lines))


@pytest.mark.parametrize(
    ("line", "row"), [("v 0,1 0 0", 9), ("v 1 2", 9), ("f 1 2", 9), ("f 1 2 x", 9), ("f 0 1 2", 9), ("f -9 1 2", 9)]
)
def test_a_line_that_makes_no_sense_is_named(tmp_path, line, row):
    with pytest.raises(InputError, match=f"box.obj, row {row}: got '{line}'"):
        load_mesh(written(tmp_path, [*POINTS, line, *FACES]))
