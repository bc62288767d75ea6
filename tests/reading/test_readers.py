# SPDX-License-Identifier: MIT
"""What is announced is checked before it is allocated, and every failure is one line."""

import io
import json
import os
import struct
import zipfile
import zlib
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from PIL import Image

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.reading.arrays import parse_npz, read_npz
from pinwm_drake.reading.contents import guarded, read_bytes, read_text
from pinwm_drake.reading.mesh_objects import read_objects
from pinwm_drake.reading.meshes import read_elements, read_scene
from pinwm_drake.reading.pictures import opened_picture
from pinwm_drake.reading.tables import cell_number, read_rows
from pinwm_drake.reading.trees import DEEPEST, parse_json, parse_yaml


def refused(call, *arguments, **options):
    """Message of the refusal, which is one line of 300 characters at most."""
    with pytest.raises(InputError) as caught:
        call(*arguments, **options)
    message = str(caught.value)
    assert len(message) <= 300
    assert message.isprintable()
    return message


@pytest.mark.parametrize("kind", ["fifo", "folder", "device", "no file"])
def test_only_regular_files_are_read(tmp_path, kind):
    path = tmp_path / "input"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "device":
        path.symlink_to("/dev/zero")
    for call in (read_bytes, read_text, read_rows, lambda path: read_npz(path, "arrays")):
        message = refused(call, path)
        assert "allowed: a file that can be read" in message


def test_links_to_files_are_followed_and_large_files_are_not_read(tmp_path):
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("file")
    assert read_bytes(tmp_path / "link", 5) == b"12345"
    assert "allowed: 4 bytes at most" in refused(read_bytes, tmp_path / "link", 4)
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 40)
    assert f"got {1 << 40} bytes" in refused(read_bytes, tmp_path / "sparse")


def test_any_failure_is_one_short_line(tmp_path):
    def fail(error):
        with guarded(tmp_path / "a.npz", "arrays"):
            raise error

    for error in (RecursionError(), MemoryError(), KeyError("x"), ValueError("two\nlines\x1b[2J" + 1000 * "é")):
        assert refused(fail, error).endswith("allowed: arrays")
    with pytest.raises(ParameterError, match=r"^mine$"):
        fail(ParameterError("mine"))


def aliases(first, line):
    """YAML of a few lines, each of which stands for 12 times the one before."""
    rows = [line.format(name, name, ", ".join([f"*{before}"] * 12)) for before, name in pairwise("abcdefgh")]
    return first + "".join(rows)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("2024-99-99", "month must be in 1..12"),
        ("!!int abc", "invalid literal"),
        ("!!bool maybe", "maybe"),
        ("[" * 3000, "levels at most"),
        ("a: [1", "row 1"),
        ("a: 1\nb: : 2", "row 2"),
        ("&a [*a]", "levels at most"),
        (aliases("a: &a [x, x]\n", "{}: &{} [{}]\n"), "with aliases"),
        (aliases("a: &a {x: 1}\n", "{}: &{}\n  <<: [{}]\n"), "with aliases"),
        ("!!python/object/apply:os.system [ls]", "could not determine a constructor"),
        ("x" * 600_000, "bytes at most"),
    ],
)
def test_yaml_that_is_none_or_too_much(tmp_path, text, words):
    assert words in refused(parse_yaml, text, tmp_path / "a.yaml")


def test_yaml_and_json_up_to_the_limits(tmp_path):
    nested = "[" * DEEPEST + "]" * DEEPEST
    assert parse_json(nested, tmp_path) == parse_yaml(nested, tmp_path) == json.loads(nested)
    for parse in (parse_json, parse_yaml):
        assert "levels at most" in refused(parse, f"[{nested}]", tmp_path / "a")
    brackets = json.dumps(["[" * 1000, '"\\'])
    assert parse_json(brackets, tmp_path) == json.loads(brackets)
    assert parse_yaml("x: &a [1e-3, 2]\ny: *a", tmp_path) == {"x": [1e-3, 2], "y": [1e-3, 2]}
    assert parse_yaml("", tmp_path) is None


def npz(**members):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content)  # of 1980: names of tests have these bytes
    return file.getvalue()


def npy(header, data=b""):
    text = f"{header}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


@pytest.mark.parametrize(
    "content",
    [
        b"",
        npz(a=b"raw"),
        npz(a=npy("{'descr': '<f8', 'fortran_order': False, 'shape': (7500000000,)}")),
        npz(a=npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", b"cos\nsystem\n.")),
        npz(a=npy("{'descr': '<U0', 'fortran_order': False, 'shape': (1000000000000,)}")),
        npz(a=npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}", bytes(8))),
        npz(a=npy("{'descr': '<U1', 'fortran_order': False, 'shape': (1,)}", b"\xff\xff\xff\xff")),
        npz(a=npy("{'descr': '<f8', 'fortran_order': False, 'shape': (" + "(" * 500)),
        npz(a=npy("{'descr': '>f8', 'fortran_order': False, 'shape': (1,)}", bytes(8))),
        npz(**{"a": npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1,)}", bytes(9))}),
    ],
)
def test_an_npz_that_is_none_or_announces_too_much(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    assert refused(read_npz, tmp_path / "a.npz", "arrays") == refused(parse_npz, content, tmp_path / "a.npz", "arrays")


def test_a_zip_bomb_and_damaged_and_encrypted_members(tmp_path):
    file = io.BytesIO()
    np.savez_compressed(file, a=np.zeros(1_000_000))
    assert parse_npz(file.getvalue(), tmp_path, "x")["a"].size == 1_000_000
    assert "8000128 bytes; allowed: 1000 bytes" in refused(parse_npz, file.getvalue(), tmp_path / "a", "x", most=1000)
    content = bytearray(file.getvalue())
    content[len(content) // 2] ^= 1
    refused(parse_npz, bytes(content), tmp_path / "a", "x")
    encrypted = bytearray(npz(a=npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1,)}", bytes(8))))
    encrypted[encrypted.index(b"PK\x01\x02") + 8] |= 1
    assert "encrypted" in refused(parse_npz, bytes(encrypted), tmp_path / "a", "x")


def test_arrays_of_all_kinds_are_read_as_numpy_writes_them(tmp_path):
    arrays = {
        "flags": np.array([True, False]),
        "text": np.array(["a", "bé"]),
        "none": np.zeros((0, 3)),
        "lone": np.array(3.5),
        "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "bytes": np.arange(5, dtype=np.uint8),
    }
    np.savez(tmp_path / "a.npz", **arrays)
    found = read_npz(tmp_path / "a.npz", "arrays")
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype
        np.testing.assert_array_equal(found[name], array)
        assert found[name].flags.writeable


def png(width, height):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(9000, 9000), (60000, 60000), (2**31 - 1, 2**31 - 1)])
def test_a_picture_of_too_many_pixels_is_not_decoded(tmp_path, size):
    (tmp_path / "a.png").write_bytes(png(*size))

    def decode():
        with opened_picture(tmp_path / "a.png") as image:
            image.load()

    assert "pixels" in refused(decode)


def test_formats_that_start_programs_are_no_pictures(tmp_path):
    Image.new("RGB", (4, 4)).save(tmp_path / "a.eps")
    (tmp_path / "a.eps").rename(tmp_path / "a.png")
    with pytest.raises(InputError, match="no image"), opened_picture(tmp_path / "a.png"):
        pass


def test_a_ply_that_announces_more_than_it_holds(tmp_path):
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float x\nend_header\n"
    (tmp_path / "a.ply").write_bytes(head.encode() + bytes(40))
    for call in (read_objects, lambda path: read_elements(path, "surfels")):
        assert "element vertex 1000000000000' in 41 bytes" in refused(call, tmp_path / "a.ply")


def glb(change):
    content = trimesh.creation.box().export(file_type="glb")
    length = struct.unpack("<I", content[12:16])[0]
    document = json.loads(content[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    head = struct.pack("<5I", 0x46546C67, 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    return head + text + rest


@pytest.mark.parametrize(
    "change",
    [
        lambda document: document["accessors"][0].update(count=10**12),
        lambda document: document["accessors"].append({"count": 10**12, "componentType": 5126, "type": "MAT4"}),
        lambda document: document["accessors"][0].update(count=-5),
        lambda document: document["nodes"].extend([{"mesh": 0}] * 100_000),
    ],
)
def test_a_glb_that_announces_more_than_it_holds(tmp_path, change):
    (tmp_path / "a.glb").write_bytes(glb(lambda document: None))
    assert sum(len(faces) for _, faces in read_objects(tmp_path / "a.glb").values()) == 12
    (tmp_path / "a.glb").write_bytes(glb(change))
    assert "at most" in refused(read_objects, tmp_path / "a.glb")


def test_materials_come_from_the_folder_of_the_mesh_alone(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "red.mtl").write_text("newmtl red\nKd 1 0 0\n")
    text = "mtllib {}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n"

    def colour(name):
        (tmp_path / "in/a.obj").write_text(text.format(name))
        (part,) = read_scene(tmp_path / "in/a.obj").geometry.values()
        return getattr(part.visual, "material", None)

    outside = colour("../red.mtl")
    assert outside is None or list(outside.diffuse[:3]) != [255, 0, 0]
    (tmp_path / "red.mtl").rename(tmp_path / "in/red.mtl")
    assert list(colour("red.mtl").diffuse[:3]) == [255, 0, 0]


def test_a_table_of_too_many_columns(tmp_path):
    (tmp_path / "a.csv").write_text(2000 * ",")
    assert "1000 columns at most" in refused(read_rows, tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text('a,b\n1,"2\n3"\n')
    assert read_rows(tmp_path / "a.csv") == [(1, ["a", "b"]), (3, ["1", "2\n3"])]
    (tmp_path / "a.csv").write_text('# "a;b\n 1  2 \n\n#\n3 4')
    rows = read_rows(tmp_path / "a.csv", ",; ", comment="#")
    assert [row for row in rows if row[1]] == [(2, ["1", "2"]), (5, ["3", "4"])]


def test_numbers_of_cells_are_in_plain_digits():
    assert [cell_number(cell) for cell in (" 1.5e2", "-.5", "+3.")] == [150, -0.5, 3]
    assert np.isnan([cell_number(cell) for cell in ("", "nan", "inf", "1e999", "1_0", "0x1", "١", "1 2")]).all()


@pytest.mark.parametrize("line", ["v 0.1", "v 0.1 0.2"])
def test_vertices_without_three_coordinates_are_refused(tmp_path, line):
    (tmp_path / "a.obj").write_text(f"{line}\n" * 3 + "f 1 2 3\n")
    assert "a vertex without three coordinates" in refused(read_scene, tmp_path / "a.obj")
    assert f"got '{line}'; allowed: \"v x y z\"" in refused(read_objects, tmp_path / "a.obj")


def test_a_hash_that_begins_like_a_number_is_text(tmp_path):
    assert parse_yaml("x: 2028e68561dcfe65", tmp_path) == {"x": "2028e68561dcfe65"}
