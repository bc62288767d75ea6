# SPDX-License-Identifier: MIT
"""Damage to files, drawn at random: bytes, kinds of files, and the structure of each format."""

import io
import json
import math
import os
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

Generator = np.random.Generator
Mutation = Callable[[Path, Generator], None]
_DEEPEST = 1000  # brackets of a YAML document that is parsed here; libyaml crashes at some ten thousand levels
_LARGE_BOMB = 0.1  # share of the bombs; making one takes a second

GARBAGE: list[Any] = [
    None, True, False, 0, -1, 1, 2, 3, 0.5, -0.0, 1e-320, 1e300, -1e300, 1e12, 2**31, 2**63, 10**30, math.nan, math.inf,
    -math.inf, "", " ", "0", "nan", "../..", "/", "/etc/passwd", "/dev/zero", "a\0b", "a\nb", "\x1b[2J", "é🦆",
    "x" * 5000, [], {}, [0], [0, 0, 0], [[0]], [None] * 4, [math.nan] * 3, [1e308] * 4, {"p": [0, 0, 0]},
    [[1, 0, 0, 0]] * 4, "2024-99-99", "1e-3", "sphere", 1 << 20_000,
]  # fmt: skip
YAML = [
    "schema_version: 2024-99-99", "!!int abc", "!!bool maybe", "!!binary '*'", "!!timestamp abc", "[" * 3000, "{" * 500,
    "a: &a [*a]", "? [1, 2]\n: 3", "- - - -", "<<: 3", "x: 0x" + "f" * 5000, "!!python/object/apply:os.getpid []",
    "\x07", "--- 1\n--- 2", "%YAML 9.9\n---\n1", "!!set {a, b}", "!!omap [a: 1]", "*nobody", "a: b: c", "\t- x", '"',
    "? ",
    "\n".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9) if k else 1}]" for k in range(30)),
    "a0: &a0 {x: 1}\n" + "\n".join(f"a{k}: &a{k}\n  <<: [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)),
]  # fmt: skip
JSON = ["[" * 100_000, '{"a":' * 5000, "1e999", "9" * 5000, '"\\ud800"', "nan", "[1,]", "", "{}", "[]", '"', "\ufeff{}"]


def mutate(folder: Path, rng: Generator) -> str:
    """Damage one file of a folder, one to three times; return how, in words."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    path = files[rng.integers(len(files))]
    own = BY_SUFFIX.get(path.suffix, [])
    words = []
    for _ in range(rng.integers(1, 4)):
        if not path.is_file() or path.is_symlink():
            break
        pool = own if own and rng.random() < 0.7 else FILES if rng.random() < 0.15 else BYTES
        kind = pool[rng.integers(len(pool))]
        try:
            kind(path, rng)
        except Exception as error:  # the damage before left nothing of the structure
            words.append(f"{kind.__name__}: {type(error).__name__}")
            continue
        words.append(kind.__name__)
    return f"{path.relative_to(folder)}: {', '.join(words)}"


def cut(path: Path, rng: Generator) -> None:
    """Truncation."""
    data = path.read_bytes()
    path.write_bytes(data[: rng.integers(len(data) + 1)])


def flip(path: Path, rng: Generator) -> None:
    """A few bits."""
    data = bytearray(path.read_bytes())
    for at in rng.integers(len(data), size=rng.integers(1, 9)):
        data[at] ^= 1 << rng.integers(8)
    path.write_bytes(bytes(data))


def overwrite(path: Path, rng: Generator) -> None:
    """A stretch of zeros, ones, the largest integers or noise."""
    data = bytearray(path.read_bytes())
    length = int(rng.integers(1, 65))
    at = int(rng.integers(len(data)))
    fills = [bytes(length), b"\xff" * length, (b"\xff\xff\xff\x7f" * length)[:length], rng.bytes(length)]
    data[at : at + length] = fills[rng.integers(len(fills))]
    path.write_bytes(bytes(data))


def insert(path: Path, rng: Generator) -> None:
    """Bytes between others."""
    data = path.read_bytes()
    at = int(rng.integers(len(data) + 1))
    path.write_bytes(data[:at] + rng.bytes(int(rng.integers(1, 33))) + data[at:])


def remove(path: Path, rng: Generator) -> None:
    """A stretch that is missing."""
    data = path.read_bytes()
    at = int(rng.integers(len(data)))
    path.write_bytes(data[:at] + data[at + int(rng.integers(1, 257)) :])


def repeat(path: Path, rng: Generator) -> None:
    """A stretch that is there many times."""
    data = path.read_bytes()
    at, length = int(rng.integers(len(data))), int(rng.integers(1, 65))
    path.write_bytes(data[:at] + data[at : at + length] * int(rng.integers(2, 2000)) + data[at:])


def noise(path: Path, rng: Generator) -> None:
    """Nothing but noise."""
    path.write_bytes(rng.bytes(int(rng.integers(0, 4000))))


def fifo(path: Path, rng: Generator) -> None:
    """A pipe that nobody writes to."""
    path.unlink()
    os.mkfifo(path)


def link(path: Path, rng: Generator) -> None:
    """A link to a device, a folder, nothing, or itself."""
    targets = ["/dev/zero", "/dev/full", "/dev/tty", "/", "/nowhere", path.name, "/proc/self/mem", "/proc/kmsg"]
    path.unlink()
    path.symlink_to(targets[rng.integers(len(targets))])


def folder(path: Path, rng: Generator) -> None:
    """A folder of that name."""
    path.unlink()
    path.mkdir()


def sparse(path: Path, rng: Generator) -> None:
    """A file of a terabyte that takes no space."""
    os.truncate(path, 1 << 40)


def missing(path: Path, rng: Generator) -> None:
    """No such file."""
    path.unlink()


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Places of all values in a document."""
    yield at
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from places(inner, (*at, key))


def changed(value: Any, rng: Generator) -> Any:
    """Return a document with a value, a key or a part of it changed."""
    found = list(places(value))
    at = found[rng.integers(len(found))]
    if not at:
        return GARBAGE[rng.integers(len(GARBAGE))]
    inner = value
    for key in at[:-1]:
        inner = inner[key]
    other = found[rng.integers(1, len(found))]
    source = value
    for key in other:
        source = source[key]
    kind = rng.integers(6)
    if kind == 0:
        del inner[at[-1]]
    elif kind == 1 and isinstance(inner, dict):
        inner[str(GARBAGE[rng.integers(len(GARBAGE) - 1)])[:300]] = inner.pop(at[-1])
    elif kind == 2:
        inner[at[-1]] = json.loads(json.dumps(source))
    elif kind == 3:
        nested: Any = inner[at[-1]]
        for _ in range(int(rng.integers(1, 200))):
            nested = [nested] if rng.random() < 0.5 else {"a": nested}
        inner[at[-1]] = nested
    elif kind == 4 and isinstance(inner[at[-1]], (int, float)):
        inner[at[-1]] = inner[at[-1]] * float(10.0 ** rng.integers(-12, 13))
    else:
        inner[at[-1]] = GARBAGE[rng.integers(len(GARBAGE))]
    return value


def json_value(path: Path, rng: Generator) -> None:
    """Another value, key or depth of a JSON document."""
    path.write_text(json.dumps(changed(json.loads(path.read_text()), rng)))


def json_text(path: Path, rng: Generator) -> None:
    """JSON that is a trap."""
    path.write_text(JSON[rng.integers(len(JSON))])


def plain_yaml(path: Path) -> Any:
    """Document of a YAML file; an error for aliases, which could take hours, and for what crashes libyaml."""
    text = path.read_text()
    if "&" in text or sum(map(text.count, "[{")) + text.count("- - ") > _DEEPEST:
        raise ValueError
    return yaml.load(text, yaml.CSafeLoader)


def yaml_value(path: Path, rng: Generator) -> None:
    """Another value, key or depth of a YAML document."""
    path.write_text(dump_yaml(changed(plain_yaml(path), rng)))


def dump_yaml(value: Any) -> str:
    """YAML of plain data, in its order."""
    text: str = yaml.dump(value, Dumper=yaml.CSafeDumper, sort_keys=False)
    return text


def yaml_text(path: Path, rng: Generator) -> None:
    """YAML that is a trap, alone, before or in the document."""
    trap, lines = YAML[rng.integers(len(YAML))], path.read_text().splitlines()
    if rng.random() < 0.4:
        path.write_text(trap)
        return
    at = int(rng.integers(len(lines) + 1))
    key, found, _ = lines[at % len(lines)].partition(":")
    lines[at % len(lines)] = f"{key}: {trap}" if found else trap
    path.write_text("\n".join(lines))


def members(path: Path) -> dict[str, bytes]:
    """Contents of the members of an archive; an error for a bomb."""
    with zipfile.ZipFile(path) as archive:
        if sum(one.file_size for one in archive.infolist()) > 2**25:
            raise ValueError
        return {name: archive.read(name) for name in archive.namelist()}


def store(path: Path, contents: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> None:
    """Write an archive."""
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in contents.items():
            archive.writestr(name, content)


def npy(array: np.ndarray) -> bytes:
    """Contents of an npy file."""
    file = io.BytesIO()
    np.lib.format.write_array(file, array, allow_pickle=True)
    return file.getvalue()


def npz_array(path: Path, rng: Generator) -> None:
    """An array of another type, shape or contents, or none."""
    contents = members(path)
    name = sorted(contents)[rng.integers(len(contents))]
    array = np.load(io.BytesIO(contents[name]))
    kind = rng.integers(9)
    if kind == 0:
        del contents[name]
        store(path, contents)
        return
    shapes = [array.reshape(-1), array[None], array[..., None], array[:0] if array.ndim else array.reshape(0)[:0]]
    if kind == 1:
        array = shapes[rng.integers(3)] if array.size else array[None]
    elif kind == 2 and array.ndim:
        array = array[: rng.integers(len(array) + 1)]
    elif kind == 3:
        types = [np.float32, np.float64, np.int64, np.uint8, bool, "U3", "S3", complex, ">f8", "M8[s]", np.float16]
        array = np.zeros(array.shape, types[rng.integers(len(types))])
    elif kind == 4 and array.dtype.kind == "f" and array.size:
        array = array.copy()
        values = [np.nan, np.inf, -np.inf, 1e300 if array.dtype == float else 1e38, -1.0, 0.0]
        array.reshape(-1)[rng.integers(array.size)] = values[rng.integers(len(values))]
    elif kind == 5 and array.dtype.kind in "iu" and array.size:
        array = array.copy()
        values = [0, np.iinfo(array.dtype).max, np.iinfo(array.dtype).min]
        array.reshape(-1)[rng.integers(array.size)] = values[rng.integers(len(values))]
    elif kind == 6 and array.dtype.kind == "U" and array.ndim == 0:
        text = str(array)
        try:
            array = np.array(json.dumps(changed(json.loads(text), rng)))
        except ValueError:
            array = np.array(str(GARBAGE[rng.integers(len(GARBAGE) - 1)]))
    elif kind == 7:
        array = np.array([{}, "pickle"], dtype=object)
    else:
        contents[f"extra{rng.integers(3)}.npy"] = contents[name]
    contents[name] = npy(array)
    store(path, contents)


def npz_header(path: Path, rng: Generator) -> None:
    """A header of an array that announces something else, by its own text."""
    contents = members(path)
    name = sorted(contents)[rng.integers(len(contents))]
    content = contents[name]
    length = struct.unpack("<H", content[8:10])[0]
    shapes = [
        "(60000000000,)",
        "(-1,)",
        "()",
        "(1000000, 1000000)",
        "(0, 99999999999999999999)",
        "(" * 300,
        "1e9",
        "(1,) * 9",
    ]
    types = ["|O", "<U0", "<U999999999", ">f8", "<f8", "|V8", "<M8[s]", "|b1", "<f2", "x", "<c16"]
    shape, kind = shapes[rng.integers(len(shapes))], types[rng.integers(len(types))]
    head = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    contents[name] = content[:8] + struct.pack("<H", len(head)) + head + content[10 + length :]
    store(path, contents)


def npz_flags(path: Path, rng: Generator) -> None:
    """An entry that says that it is encrypted, of another compression or of another size."""
    data = bytearray(path.read_bytes())
    at = data.rindex(b"PK\x01\x02") if rng.random() < 0.5 else data.index(b"PK\x01\x02")
    fields = {8: 1, 10: int(rng.integers(1, 100)), 20: int(rng.integers(2**31)), 24: int(rng.integers(2**32)), 42: 7}
    offset = list(fields)[rng.integers(len(fields))]
    value = fields[offset]
    width = 2 if offset in (8, 10) else 4
    data[at + offset : at + offset + width] = value.to_bytes(width, "little")
    path.write_bytes(bytes(data))


def npz_bomb(path: Path, rng: Generator) -> None:
    """Zeros, mostly of some MB, up to 200 MB, of which a file needs a thousandth."""
    contents = members(path)
    name = sorted(contents)[rng.integers(len(contents))]
    number = int(rng.integers(10, 200) if rng.random() < _LARGE_BOMB else rng.integers(2, 20)) * 125_000
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({number},), }}\n".encode()
    small = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for other, content in contents.items():
            archive.writestr(other, small + bytes(8 * number) if other == name else content)


def csv_cell(path: Path, rng: Generator) -> None:
    """Another cell, row or header of a table."""
    lines = path.read_text().splitlines()
    at = int(rng.integers(len(lines)))
    cells = lines[at].split(",")
    kind = rng.integers(6)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines[at] = lines[0]
    elif kind == 2:
        lines[at] = ",".join(cells[:-1] if rng.random() < 0.5 else [*cells, "1"])
    elif kind == 3:
        lines[at:at] = [lines[at]] * int(rng.integers(1, 3000))
    else:
        values = [*map(str, GARBAGE[:-1]), '"', '"a\nb"', "1_0", "0x10", "١", "," * 3000, "x" * 200_000]
        cells[rng.integers(len(cells))] = values[rng.integers(len(values))]
        lines[at] = ",".join(cells)
    path.write_text("\n".join(lines), errors="surrogatepass")


def word(path: Path, rng: Generator) -> None:
    """Another word of a text, such as an OBJ file or the header of a PLY file."""
    data = path.read_bytes()
    head, mark, rest = data.partition(b"end_header")
    text = (head if mark else data).decode("latin-1")
    lines = text.split("\n")
    at = int(rng.integers(len(lines)))
    words = lines[at].split(" ")
    values = [
        *map(str, GARBAGE[:-1]),
        "1000000000000",
        "-7",
        "list",
        "double",
        "uchar",
        "f",
        "v",
        "0",
        "1/1/1",
        "usemtl",
        "mtllib",
    ]
    words[rng.integers(len(words))] = values[rng.integers(len(values))]
    lines[at] = " ".join(words)
    changed_text = "\n".join(lines).encode("utf-8", "surrogatepass")
    path.write_bytes(changed_text + mark + rest if mark else changed_text)


def png_size(path: Path, rng: Generator) -> None:
    """A PNG whose header announces another size or mode, with the right checksum."""
    data = bytearray(path.read_bytes())
    sizes = [0, 1, 63, 8000, 40_000, 2**31 - 1, 2**32 - 1]
    width, height = (sizes[k] for k in rng.integers(len(sizes), size=2))
    depth, kind = (int(k) for k in (rng.choice([1, 2, 4, 8, 16, 99]), rng.integers(8)))
    keep = rng.random() < 0.5
    head = struct.pack(">IIBBBBB", width, height, data[24] if keep else depth, data[25] if keep else kind, 0, 0, 0)
    data[16:29] = head
    data[29:33] = struct.pack(">I", zlib.crc32(b"IHDR" + head))
    path.write_bytes(bytes(data))


def png_bomb(path: Path, rng: Generator) -> None:
    """A white PNG, mostly of some million pixels, up to 30 million."""
    side = int(rng.integers(2000, 5400) if rng.random() < _LARGE_BOMB else rng.integers(500, 2000))

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    rows = zlib.compress((b"\0" + b"\xff" * (3 * side)) * side, 1)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b""))


def glb_value(path: Path, rng: Generator) -> None:
    """Another value, key or depth of the document in a GLB file."""
    content = path.read_bytes()
    length = struct.unpack("<I", content[12:16])[0]
    text = json.dumps(changed(json.loads(content[20 : 20 + length]), rng)).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    path.write_bytes(struct.pack("<5I", 0x46546C67, 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest)


def onnx_graph(path: Path, rng: Generator) -> None:
    """Another operator, edge, attribute, weight or shape of a network."""
    import onnx

    model = onnx.load_from_string(path.read_bytes())
    graph, kind = model.graph, rng.integers(8)
    node = graph.node[rng.integers(len(graph.node))]
    tensor = graph.initializer[rng.integers(len(graph.initializer))]
    names = sorted({node.op_type for node in graph.node} | {"Loop", "If", "Scan", "ConstantOfShape", "Tile", "Expand"})
    if kind == 0:
        node.op_type = names[rng.integers(len(names))]
    elif kind == 1 and len(node.input):
        other = graph.node[rng.integers(len(graph.node))]
        node.input[rng.integers(len(node.input))] = other.output[0]
    elif kind == 2 and len(node.attribute):
        attribute = node.attribute[rng.integers(len(node.attribute))]
        attribute.i = int(rng.integers(-(2**40), 2**40))
        if attribute.ints:
            attribute.ints[rng.integers(len(attribute.ints))] = int(rng.choice([-1, 0, 1, 7, 2**31, 2**40]))
    elif kind == 3 and len(tensor.dims):
        tensor.dims[rng.integers(len(tensor.dims))] = int(rng.choice([-1, 0, 1, 3, 2**31, 2**40]))
    elif kind == 4 and tensor.raw_data:
        values = bytearray(tensor.raw_data)
        for at in rng.integers(len(values), size=8):
            values[at] = int(rng.integers(256))
        tensor.raw_data = bytes(values)
    elif kind == 5:
        tensor.data_location = 1
        entry = tensor.external_data.add()
        entry.key, entry.value = "location", "../../../etc/passwd"
    elif kind == 6:
        ends = [*graph.input, *graph.output]
        shape = ends[rng.integers(len(ends))].type.tensor_type.shape
        if len(shape.dim):
            shape.dim[rng.integers(len(shape.dim))].dim_value = int(rng.choice([-1, 0, 1, 64, 2**40]))
    else:
        del graph.node[rng.integers(len(graph.node))]
    path.write_bytes(model.SerializeToString())


def copied(path: Path, rng: Generator) -> None:
    """Contents of another file of the sample."""
    others = sorted(one for one in path.parent.rglob("*") if one.is_file() and not one.is_symlink() and one != path)
    shutil.copyfile(others[rng.integers(len(others))], path)


BYTES: list[Mutation] = [cut, flip, flip, overwrite, overwrite, insert, remove, repeat, noise]
FILES: list[Mutation] = [fifo, link, link, folder, sparse, missing, copied]
NPZ: list[Mutation] = [npz_array, npz_array, npz_array, npz_header, npz_header, npz_flags, npz_bomb]
BY_SUFFIX: dict[str, list[Mutation]] = {
    ".json": [json_value, json_value, json_value, json_text],
    ".yaml": [yaml_value, yaml_value, yaml_value, yaml_text],
    ".npz": NPZ,
    ".csv": [csv_cell],
    ".txt": [word],
    ".obj": [word],
    ".mtl": [word],
    ".ply": [word],
    ".png": [png_size, png_size, png_bomb],
    ".glb": [glb_value],
    ".onnx": [onnx_graph],
}
