# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from pinwm_drake.errors import InputError, RenderingError
from pinwm_drake.models import model_path
from pinwm_drake.rendering.harmonics import Y0
from pinwm_drake.rendering.painted import painted_surfels
from pinwm_drake.spatial.rotations import quaternion_to_matrix

CUBE = model_path("cube/cube_visual.obj")


def test_surfels_lie_flat_on_the_mesh_in_the_colours_of_its_faces():
    surfels = painted_surfels(CUBE, 600)
    surfels.check()
    assert (surfels.num_surfels, surfels.degree) == (600, 0)
    points = surfels.p_OS.double().numpy()
    # float32 of centimetres: some 1e-9 m.
    assert np.abs(np.abs(points).max(axis=1) - 0.03).max() < 1e-8
    side = np.abs(points).argmax(axis=1)
    normals = quaternion_to_matrix(surfels.q_OS.double())[:, :, 2].numpy()
    assert (normals[np.arange(600), side] * np.sign(points[np.arange(600), side]) > 1 - 1e-5).all()
    colours = (surfels.sh[:, 0] * Y0 + 0.5).numpy()
    # The middle of the side at +x is red, that at -y yellow; see models/paint.py.
    for axis, sign, colour in ((0, 1, (0.80, 0.16, 0.14)), (1, -1, (0.93, 0.82, 0.20))):
        middle = (side == axis) & (sign * points[:, axis] > 0)
        middle &= (np.abs(np.delete(points, axis, axis=1)) < 0.009).all(axis=1)
        assert middle.sum() > 5
        # An MTL file's number becomes one of 256.
        assert np.abs(colours[middle] - colour).max() < 0.5 / 255 + 1e-6


def test_no_surfel_hangs_over_a_crease():
    surfels = painted_surfels(CUBE, 600)
    # Distance to the border of the side that a surfel lies on, against the smaller of its scales.
    border = 0.03 - np.sort(np.abs(surfels.p_OS.double().numpy()), axis=1)[:, 1]
    assert (border > surfels.log_scale.exp().min(dim=1).values.numpy()).all()


def test_the_same_seed_gives_the_same_surfels():
    first, second, other = painted_surfels(CUBE, 200), painted_surfels(CUBE, 200), painted_surfels(CUBE, 200, seed=1)
    assert all(torch.equal(a, b) for a, b in zip(first.tensors().values(), second.tensors().values(), strict=True))
    assert not torch.equal(first.p_OS, other.p_OS)


def test_numbers_out_of_range_are_refused():
    with pytest.raises(RenderingError, match="number=99; allowed: 100 or more"):
        painted_surfels(CUBE, 99)


def test_a_ball_has_no_creases(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    corners = "".join(f"v {x} {y} {z}\n" for x, y, z in ball.vertices)
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in ball.faces + 1)
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\nusemtl red\n{corners}{faces}")
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 0.8 0.1 0.1\n")
    surfels = painted_surfels(tmp_path / "a.obj", 300)
    surfels.check()
    assert surfels.num_surfels == 300
    # Evenly spread: the nearest neighbours are about as far as on a grid of 300 squares, 10 mm.
    gaps = torch.cdist(surfels.p_OS, surfels.p_OS) + torch.eye(300)
    assert 0.005 < float(gaps.min(dim=1).values.min()) < float(gaps.min(dim=1).values.max()) < 0.015


def test_a_texture_is_refused(tmp_path):
    Image.new("RGB", (2, 2)).save(tmp_path / "a.png")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl red\n" + FACE + "vt 0 0\nf 1/1 2/1 3/1\n")
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 0.8 0.1 0.1\nmap_Kd a.png\n")
    with pytest.raises(InputError, match="got material red with a texture; allowed: materials of one colour"):
        painted_surfels(tmp_path / "a.obj")


FACE = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0.1 0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no such file"),
        ("", "allowed: an OBJ file of coloured faces"),
        (FACE + "f 1 2 3\n", "faces without a material"),
        ("mtllib a.mtl\nusemtl red\n" + FACE + "f 1 3 4\n", "faces without area"),
        ("mtllib a.mtl\nusemtl red\nv 1e300 0 0\n" + FACE + "f 1 2 3\n", "an extent of 1e+300 m"),
        ("mtllib a.mtl\nusemtl red\nv nan 0 0\n" + FACE + "f 1 2 3\n", "a coordinate that is not finite"),
        ("mtllib a.mtl\nusemtl red\n" + FACE + "f 1 2\n", "no faces"),
        ("mtllib a.mtl\nusemtl red\n" + FACE, "no faces"),
        ("mtllib a.mtl\nusemtl blue\n" + FACE + "f 1 2 3\n", "faces without a material"),
    ],
)
def test_files_that_cannot_be_used_are_refused(tmp_path, text, message):
    path = tmp_path / "a.obj"
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 0.8 0.1 0.1\n")
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=r"a\.obj: .*allowed: ") as error:
        painted_surfels(path)
    assert message in str(error.value)


def test_a_single_face_has_no_creases(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 0.8 0.1 0.1\n")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nusemtl red\n" + FACE + "f 1 2 3\n")
    surfels = painted_surfels(tmp_path / "a.obj", 200)
    assert surfels.num_surfels == 200
    assert torch.allclose(surfels.p_OS[:, 2], torch.zeros(200, dtype=surfels.p_OS.dtype))
