# SPDX-License-Identifier: MIT
import errno
import re
import resource

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from pinwm_drake.errors import InputError, RenderingError
from pinwm_drake.rendering.ply import read_ply, write_ply
from pinwm_drake.rendering.surfels import Surfels


def random_surfels(number=7, degree=3, seed=0):
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator)

    K = (degree + 1) ** 2
    return Surfels(normal(number, 3), normal(number, 4), normal(number, 2) - 5, normal(number), normal(number, K, 3))


def rewrite(path, change):
    """Writes the file's rows again after change(rows); a new array may come back."""
    rows = PlyData.read(path, mmap=False)["vertex"].data.copy()
    new = change(rows)
    PlyData([PlyElement.describe(rows if new is None else new, "vertex")], byte_order="<").write(path)


@pytest.fixture
def ply(tmp_path):
    path = tmp_path / "surfels.ply"
    write_ply(path, random_surfels())
    return path


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_round_trip_is_bit_exact(tmp_path, degree):
    surfels = random_surfels(degree=degree)
    write_ply(tmp_path / "a.ply", surfels)
    back = read_ply(tmp_path / "a.ply")
    assert back.degree == degree
    for name, tensor in surfels.tensors().items():
        assert torch.equal(getattr(back, name), tensor), name
        assert getattr(back, name).dtype == torch.float32
    back.check()


def test_properties_carry_the_names_and_order_of_2dgs(ply):
    names = PlyData.read(ply)["vertex"].data.dtype.names
    rest = tuple(f"f_rest_{i}" for i in range(45))
    assert names == (
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *rest),
        *("opacity", "scale_0", "scale_1", "rot_0", "rot_1", "rot_2", "rot_3"),
    )
    rows, surfels = PlyData.read(ply)["vertex"].data, random_surfels()
    # f_rest has all of red first: 14 is red's last, 15 green's first, 44 blue's last.
    for index, (k, channel) in {0: (1, 0), 14: (15, 0), 15: (1, 1), 44: (15, 2)}.items():
        assert np.array_equal(rows[f"f_rest_{index}"], surfels.sh[:, k, channel].numpy())


def test_normals_are_unit_and_turn_with_the_quaternion(tmp_path):
    surfels = random_surfels(1)
    # 90 degrees about x take z to -y.
    turned = Surfels(**{**surfels.tensors(), "q_OS": torch.tensor([[2.0, 2.0, 0.0, 0.0]])})
    write_ply(tmp_path / "a.ply", turned)
    row = PlyData.read(tmp_path / "a.ply")["vertex"].data[0]
    assert [row["nx"], row["ny"], row["nz"]] == pytest.approx([0.0, -1.0, 0.0], abs=1e-6)


def test_the_released_surfels_load(shared, tmp_path):
    path = shared / "data/pinwm_push_t/reference_splats/point_cloud.ply"
    surfels = read_ply(path)
    assert (surfels.num_surfels, surfels.degree) == (5398, 3)
    surfels.check()
    write_ply(tmp_path / "again.ply", surfels)
    theirs, ours = PlyData.read(path)["vertex"].data, PlyData.read(tmp_path / "again.ply")["vertex"].data
    for name in theirs.dtype.names:
        if name not in ("nx", "ny", "nz"):  # they wrote zeros
            assert np.array_equal(theirs[name].astype("f4"), ours[name]), name


def test_text_and_double_and_big_endian_files_load(ply):
    rows = PlyData.read(ply, mmap=False)["vertex"].data
    wide = rows.astype([(name, "f8") for name in rows.dtype.names])
    PlyData([PlyElement.describe(wide, "vertex")], text=True).write(ply)
    assert torch.equal(read_ply(ply).sh, random_surfels().sh)
    PlyData([PlyElement.describe(wide, "vertex")], byte_order=">").write(ply)
    assert torch.equal(read_ply(ply).p_OS, random_surfels().p_OS)


def without(*names):
    def change(rows):
        keep = [name for name in rows.dtype.names if name not in names]
        new = np.empty(len(rows), [(name, "f4") for name in keep])
        for name in keep:
            new[name] = rows[name]
        return new

    return change


def with_type(name, kind):
    def change(rows):
        return rows.astype([(n, kind if n == name else "f4") for n in rows.dtype.names])

    return change


def with_value(row, **values):
    def change(rows):
        for name, value in values.items():
            rows[name][row] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without("opacity"), r"got vertices without opacity; allowed: the properties x, y, z, f_dc_0"),
        (without("rot_3", "scale_1"), r"without scale_1, rot_3"),
        (without("f_rest_44"), r"got 44 of f_rest; allowed: .* 0, 9, 24 or 45"),
        (with_type("scale_0", "i4"), r"got property 'property int scale_0'; allowed: float or double scale_0"),
        (with_value(2, x=np.nan), r", row 3: got x = nan; allowed: finite numbers"),
        (with_value(6, f_rest_17=np.inf), r", row 7: got f_rest_17 = inf"),
        (with_value(0, opacity=-np.inf), r", row 1: got opacity = -inf"),
        (with_value(4, rot_0=0, rot_1=0, rot_2=0, rot_3=0), r", row 5: got rot_0..3 of 0; allowed: quaternions"),
        (lambda rows: rows[:0], r"got 0 surfels; allowed: 1 surfel or more"),
    ],
)
def test_bad_rows_name_property_and_row(ply, change, message):
    rewrite(ply, change)
    with pytest.raises(InputError, match=message) as caught:
        read_ply(ply)
    assert str(caught.value).startswith(str(ply))


def test_a_number_beyond_float32_is_named(ply):
    rewrite(ply, with_type("y", "f8"))
    rewrite(ply, with_value(1, y=1e300))
    with pytest.raises(InputError, match=r"row 2: got y = 1e\+300; allowed: finite"):
        read_ply(ply)


def test_3d_gaussians_are_refused(ply):
    def change(rows):
        new = np.empty(len(rows), [*((n, "f4") for n in rows.dtype.names), ("scale_2", "f4")])
        for name in rows.dtype.names:
            new[name] = rows[name]
        new["scale_2"] = 0
        return new

    rewrite(ply, change)
    with pytest.raises(InputError, match="scale_2, so 3D Gaussians; allowed: surfels of 2DGS"):
        read_ply(ply)


def test_a_list_property_is_refused(tmp_path):
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1"]
    rows = np.zeros(2, [*((n, "f4") for n in names), *((f"rot_{i}", "f4") for i in range(3)), ("rot_3", "O")])
    rows["rot_3"] = [np.zeros(2, "f4")] * 2
    PlyData([PlyElement.describe(rows, "vertex", val_types={"rot_3": "f4"})], byte_order="<").write(tmp_path / "a.ply")
    with pytest.raises(InputError, match=r"got property 'property list .* rot_3'; allowed: float or double rot_3"):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize("kept", [0.3, 0.9, 0.999])
def test_a_truncated_file_is_named_as_such(ply, kept):
    whole = ply.read_bytes()
    ply.write_bytes(whole[: int(kept * len(whole))])
    with pytest.raises(InputError, match=re.escape(str(ply)) + r".*(truncated|unreadable)"):
        read_ply(ply)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: [*lines[:-1], "word" + lines[-1]], "unreadable contents"),
        (lambda lines: [*lines[:-1], lines[-1].rsplit(maxsplit=1)[0]], "unreadable contents"),
        (lambda lines: [*lines[:-7], *(line.rsplit(maxsplit=1)[0] for line in lines[-7:])], "unreadable contents"),
        (lambda lines: lines[:-2], r"truncated file \(5 of 7 vertices\)"),
        (lambda lines: [line.replace("vertex 7", "vertex -7") for line in lines], r"got -7 surfels"),
    ],
)
def test_broken_text_is_refused(ply, change, message):
    PlyData([PlyElement.describe(PlyData.read(ply, mmap=False)["vertex"].data, "vertex")], text=True).write(ply)
    ply.write_text("\n".join(change(ply.read_text().splitlines())) + "\n")
    with pytest.raises(InputError, match=re.escape(str(ply)) + ".*" + message):
        read_ply(ply)


@pytest.mark.parametrize("text", [False, True])
def test_other_elements_before_the_vertices_are_passed_over(ply, text):
    rows, faces = PlyData.read(ply, mmap=False)["vertex"].data, np.zeros(2, [("vertex_indices", "i4", (3,))])
    PlyData([PlyElement.describe(faces, "face"), PlyElement.describe(rows, "vertex")], text=text).write(ply)
    assert torch.equal(read_ply(ply).q_OS, random_surfels().q_OS)


@pytest.mark.parametrize(
    "contents",
    [b"", b"OFF 3 1 0\n", b"\xff\xd8\xff\xe0" * 100, b"ply\nformat binary_little_endian 1.0\n", bytes(range(256)) * 8],
)
def test_what_is_no_ply_is_refused(tmp_path, contents):
    path = tmp_path / "a.ply"
    path.write_bytes(contents)
    with pytest.raises(InputError, match=r"unreadable contents|truncated") as caught:
        read_ply(path)
    assert "\n" not in str(caught.value)


def test_a_header_that_claims_too_much_is_refused(ply):
    ply.write_bytes(ply.read_bytes().replace(b"element vertex 7\n", b"element vertex 7000000000000\n"))
    with pytest.raises(InputError, match=r"truncated|unreadable"):
        read_ply(ply)


def test_no_file_and_no_vertices(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_ply(tmp_path / "none.ply")
    with pytest.raises(InputError, match="no such file"):
        read_ply(tmp_path)
    rows = np.zeros(1, [("a", "f4")])
    PlyData([PlyElement.describe(rows, "cloud")]).write(tmp_path / "a.ply")
    with pytest.raises(InputError, match="got a PLY with cloud; allowed: a PLY with an element 'vertex'"):
        read_ply(tmp_path / "a.ply")


def test_a_full_disk_leaves_the_earlier_file(ply, monkeypatch):
    before = ply.read_bytes()

    def full(path, names, columns):
        path.write_bytes(b"ply\n")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("pinwm_drake.rendering.ply.write_vertices", full)
    with pytest.raises(InputError, match=r"surfels\.ply: no space left on device; allowed: a file that can be"):
        write_ply(ply, random_surfels(seed=1))
    assert ply.read_bytes() == before
    assert [path.name for path in ply.parent.iterdir()] == ["surfels.ply"]


def test_a_write_that_stops_half_way_leaves_the_earlier_file(ply):
    before = ply.read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before), hard))
    try:
        with pytest.raises(InputError, match=r"surfels\.ply: got .*; allowed: a file that can be"):
            write_ply(ply, random_surfels(1000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert ply.read_bytes() == before
    assert [path.name for path in ply.parent.iterdir()] == ["surfels.ply"]


def test_no_folder(tmp_path):
    with pytest.raises(InputError, match="no such file or directory"):
        write_ply(tmp_path / "none" / "a.ply", random_surfels())


def test_unusable_surfels_are_not_written(tmp_path):
    surfels = random_surfels()
    path = tmp_path / "a.ply"
    broken = surfels.p_OS.clone()
    broken[3, 1] = torch.nan
    for tensors, message in (
        ({"p_OS": broken}, r"p_OS\[3, 1\] is nan"),
        ({"sh": surfels.sh[None]}, r"sh is \(1, 7, 16, 3\); allowed in a PLY"),
        ({"q_OS": torch.zeros(7, 4)}, r"q_OS\[0\] is zero"),
    ):
        with pytest.raises(RenderingError, match=message):
            write_ply(path, Surfels(**{**surfels.tensors(), **tensors}))
    with pytest.raises(RenderingError, match="no surfel to write"):
        write_ply(path, Surfels(**{name: value[:0] for name, value in surfels.tensors().items()}))
    assert not path.exists()
