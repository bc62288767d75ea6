# SPDX-License-Identifier: MIT
"""Reading meshes, with an error for each way in which a file can be unusable, and their mass properties."""

import numpy as np
import pytest
import trimesh

from pinwm_drake.errors import GeometryError, InputError
from pinwm_drake.geometry.meshes import load_mesh, load_pieces, mass_properties

TETRAHEDRON = ["v 0 0 0", "v 0.1 0 0", "v 0 0.1 0", "v 0 0 0.1", "f 1 3 2", "f 1 2 4", "f 2 3 4", "f 1 4 3"]


def write(folder, lines, name="mesh.obj"):
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_closed_mesh_is_read_and_turned_outwards(tmp_path):
    mesh = load_mesh(write(tmp_path, TETRAHEDRON))
    assert mesh.volume == pytest.approx(1e-3 / 6)
    inverted = [line if line[0] == "v" else " ".join(["f", *line.split()[:0:-1]]) for line in TETRAHEDRON]
    assert load_mesh(write(tmp_path, inverted)).volume == pytest.approx(1e-3 / 6)
    path = tmp_path / "mesh.stl"
    trimesh.creation.box(extents=(0.1, 0.2, 0.3)).export(path)
    assert load_mesh(path).volume == pytest.approx(0.006)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["hello"], "no faces"),
        ([], "no faces"),
        (TETRAHEDRON[:-1], "open surface"),
        (["v nan 0 0", *TETRAHEDRON[1:]], "not finite"),
        (["v 0 0 0", "v 100 0 0", "v 0 100 0", "v 0 0 100", *TETRAHEDRON[4:]], "100 m.*is it in millimetres"),
        (["v 0 0 0", "v 1e-4 0 0", "v 0 1e-4 0", "v 0 0 1e-4", *TETRAHEDRON[4:]], "0.0001 m.*millimetres"),
        ([*TETRAHEDRON[:4], "f 1 3 9", *TETRAHEDRON[5:]], "a face of corner 9; allowed: 1 to 4"),
        (["v 0 0 0", "v 0.1 0 0", "v 0 0.1 0", "v 0.1 0.1 0", *TETRAHEDRON[4:]], "without volume"),
    ],
)
def test_an_unusable_file_is_named_with_what_is_wrong(tmp_path, lines, message):
    path = write(tmp_path, lines)
    with pytest.raises(InputError, match=message) as error:
        load_mesh(path)
    assert str(path) in str(error.value)


def test_an_open_mesh_is_not_mended(tmp_path):
    box = trimesh.creation.box(extents=(0.1, 0.2, 0.3))
    path = tmp_path / "open.obj"
    trimesh.Trimesh(box.vertices, box.faces[1:], process=False).export(path)
    with pytest.raises(InputError, match="an open surface"):
        load_mesh(path)


def test_missing_and_unreadable_files(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_mesh(tmp_path / "nothing.obj")
    with pytest.raises(InputError, match="got a folder"):
        load_mesh(tmp_path)
    with pytest.raises(InputError, match="allowed: a watertight triangle mesh"):
        load_mesh(tmp_path / ("long" * 1000))
    for name in ("noise.stl", "noise.glb", "noise.xyz123"):
        path = tmp_path / name
        path.write_bytes(b"\x00\x01\x02" * 50)
        with pytest.raises(InputError, match=r"unreadable|no faces"):
            load_mesh(path)


@pytest.mark.parametrize("read", [load_mesh, load_pieces])
@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".glb"])
def test_a_broken_file_is_refused_wherever_it_breaks(tmp_path, read, suffix, recwarn):
    path = tmp_path / f"mesh{suffix}"
    trimesh.creation.icosphere(subdivisions=1, radius=0.1).export(path)
    whole = path.read_bytes()
    assert len(read(path).vertices if read is load_mesh else read(path)) > 0
    for share in (0.3, 0.6, 0.9):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=str(path)):
            read(path)
    assert not [warning for warning in recwarn if issubclass(warning.category, RuntimeWarning)]


@pytest.mark.parametrize("read", [load_mesh, load_pieces])
def test_a_face_of_a_corner_that_is_not_there_is_refused(tmp_path, read):
    path, box = tmp_path / "mesh.glb", trimesh.creation.box(extents=(0.1, 0.2, 0.3))
    box.export(path)
    faces = np.asarray(box.faces, np.uint32)
    whole = path.read_bytes()
    assert whole.count(faces.tobytes()) == 1
    faces[3, 1] = len(box.vertices) + 5
    path.write_bytes(whole.replace(np.asarray(box.faces, np.uint32).tobytes(), faces.tobytes()))
    with pytest.raises(InputError, match=r"mesh\.glb: got unreadable contents \(a face of corner 13, of 8\)"):
        read(path)


def test_mass_properties_of_a_box():
    size, mass = np.array([0.1, 0.2, 0.3]), 2.0
    box = trimesh.creation.box(extents=size)
    box.apply_translation([1.0, 2.0, 3.0])
    # m / 12 (b^2 + c^2) about the centre of mass.
    expected = np.diag(mass / 12.0 * (size @ size - size**2))
    for properties in (mass_properties(box, mass=mass), mass_properties(box, density=mass / np.prod(size))):
        assert properties.mass == pytest.approx(mass)
        np.testing.assert_allclose(properties.p_com, [1.0, 2.0, 3.0], atol=1e-12)
        np.testing.assert_allclose(properties.inertia, expected, atol=1e-12)


@pytest.mark.parametrize(
    "arguments", [{}, {"mass": 1.0, "density": 1.0}, {"mass": 0.0}, {"mass": -1.0}, {"density": np.nan}]
)
def test_mass_properties_refuses_what_is_no_mass(arguments):
    with pytest.raises(GeometryError, match="allowed"):
        mass_properties(trimesh.creation.box(), **arguments)
    with pytest.raises(GeometryError, match=r"got an open surface.*allowed: a closed mesh around a volume"):
        mass_properties(trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), mass=1.0)


def test_the_released_meshes(shared):
    folder = shared / "data/pinwm_push_t/meshes"
    block = mass_properties(load_mesh(folder / "object.obj"), mass=1.0)
    np.testing.assert_allclose(block.p_com, 0.0, atol=1e-12)
    # Two boxes a x b x c of half the mass, 35 mm from the centre: m / 24 (..) each, and the parallel axis
    # theorem.
    expected = np.diag([0.04**2 + 0.05**2 + 0.1**2 + 0.05**2, 2 * 0.05**2 + 0.1**2 + 0.04**2, 2 * (0.1**2 + 0.04**2)])
    expected = expected / 24.0 + np.diag([0.035**2, 0.0, 0.035**2])
    np.testing.assert_allclose(block.inertia, expected, atol=1e-12)
    pieces = load_pieces(folder / "pusher.obj")
    assert len(pieces) == 33
    # In the order of the file: the first piece holds the file's first vertex.
    assert np.any(np.all(pieces[0].vertices == [-0.009221, -0.008566, -0.030652], axis=1))


def test_pieces_must_be_convex(tmp_path, shared):
    pieces = load_pieces(shared / "data/pinwm_push_t/meshes/object.obj")
    assert [len(piece.vertices) for piece in pieces] == [8, 8]
    trimesh.creation.annulus(0.03, 0.04, 0.1).export(tmp_path / "ring.obj")
    with pytest.raises(InputError, match=r"of its convex hull.*decompose"):
        load_pieces(tmp_path / "ring.obj")
