# SPDX-License-Identifier: MIT
"""Files of meshes and of vertices, parsed by trimesh after a look at what they announce."""

import codecs
import io
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.exchange.ply import load_ply
from trimesh.resolvers import Resolver

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import guarded, read_bytes
from pinwm_drake.reading.trees import parse_json

_MOST_BYTES, _MOST_TEXT = 2**28, 2**26
_MOST_NODES = 10_000  # of the scene of a GLB file
_MOST_NUMBERS = 2**26  # of all accessors and instances of a GLB file
_KINDS = (".obj", ".stl", ".ply", ".off", ".glb")
_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32"),  # begins as that of UTF-16
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_TEXTS = ".obj", ".off", ".stl", ".ply"
_ALLOWED = "a triangle mesh"
_HEADER_LINES = 10_000
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


class _Beside(Resolver):
    """Files in the folder of a mesh, and no others."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, key: str) -> bytes:
        path = self._folder / key.strip()
        if not path.resolve().is_relative_to(self._folder.resolve()):
            raise InputError(path, value="a file of another folder", allowed="files beside the mesh")
        return read_bytes(path, _MOST_BYTES)

    def write(self, name: str, data: object) -> None:
        raise NotImplementedError

    def namespaced(self, namespace: str) -> "_Beside":
        return _Beside(self._folder / namespace)

    def keys(self) -> Iterator[str]:
        return (path.name for path in self._folder.iterdir())


def mesh_contents(path: Path) -> bytes:
    """Return the contents of a mesh file whose announced sizes make sense; text in UTF-16 or UTF-32 as UTF-8.

    Raises:
        InputError: It is no regular file, of another kind, too large, or announces more than it holds.
    """
    kind = path.suffix.lower()
    if kind not in _KINDS:
        raise InputError(path, value=f"a file of the kind {path.suffix!r}", allowed=", ".join(_KINDS))
    content = read_bytes(path, _MOST_TEXT if kind in (".obj", ".off") else _MOST_BYTES)
    with guarded(path, _ALLOWED):
        content = _as_utf8(path, content)
        if kind == ".ply":
            _check_ply(content, path, _ALLOWED)
        if kind == ".glb":
            _check_glb(content, path)
    return content


def read_scene(path: Path, allowed: str = _ALLOWED) -> trimesh.Scene:
    """Read a mesh file with a geometry for each of its materials, which may be in files beside it.

    Raises:
        InputError: As for `mesh_contents`, or trimesh cannot read it; `allowed` says what was expected.
    """
    with guarded(path, allowed), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kind = path.suffix[1:].lower()
        beside = _Beside(path.parent)
        scene = trimesh.load_scene(
            io.BytesIO(mesh_contents(path)), file_type=kind, resolver=beside, process=False, group_material=True
        )
        for mesh in scene.geometry.values():
            if np.shape(getattr(mesh, "vertices", np.zeros((0, 3))))[1:] != (3,):  # trimesh takes an OBJ of "v 1 2"
                raise InputError(path, value="a vertex without three coordinates", allowed='"v x y z"')
        return scene


def read_elements(path: Path, allowed: str) -> tuple[dict[str, Any], bytes]:
    """Read the elements of a PLY file as trimesh gives them, and the file's contents.

    Raises:
        InputError: It is no regular file, or announces more than it holds; what the parser raises is left to the
            caller.
    """
    content = read_bytes(path, _MOST_BYTES)
    _check_ply(content, path, allowed)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # numpy only warns of text that holds no number
        return load_ply(io.BytesIO(content), skip_materials=True)["metadata"]["_ply_raw"], content


def _as_utf8(path: Path, data: bytes) -> bytes:
    """Contents as they are, or in UTF-8 where they begin with a byte order mark or have a zero in their first two."""
    if path.suffix.lower() not in _TEXTS or _is_binary_stl(path, data):
        return data
    codec = next((codec for mark, codec in _MARKS if data.startswith(mark)), "")
    if not codec and len(data) > 1 and (data[0] == 0) != (data[1] == 0) and path.suffix.lower() != ".ply":
        codec = "utf-16-be" if data[0] == 0 else "utf-16-le"
    try:
        return data.decode(codec).removeprefix("\ufeff").encode() if codec else data
    except UnicodeDecodeError as error:
        raise InputError(path, value=f"text that is no {codec}", allowed="text in UTF-8") from error


def _is_binary_stl(path: Path, data: bytes) -> bool:
    return (
        path.suffix.lower() == ".stl"
        and len(data) >= 84
        and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
    )


def _check_ply(content: bytes, path: Path, allowed: str) -> None:
    """Raise InputError where a PLY header announces more rows than its file can hold, or is too long."""
    head, found, data = content.partition(b"end_header")
    lines = head.splitlines()
    if not found or len(lines) > _HEADER_LINES:
        raise InputError(path, value="a truncated file: no end of a header", allowed=allowed)
    text = b"ascii" in b"".join(lines[1:2]).lower()
    if text and len(content) > _MOST_TEXT:
        raise InputError(path, value=f"{len(content)} bytes of text", allowed=f"{_MOST_TEXT} at most")
    for row, line in enumerate(lines, start=1):
        words = line.split()
        if words[:1] != [b"element"]:
            continue
        # A row is a byte or more, and a line of text is two.
        if words[2:] and words[2].isdigit() and (len(words[2]) > 12 or int(words[2]) > len(data)):
            value = f"a truncated file: '{line.decode('latin-1').strip()}' in {len(data)} bytes"
            raise InputError(path, row=row, value=value, allowed="a whole PLY file")


def _check_glb(content: bytes, path: Path) -> None:
    """Raise InputError where the accessors or instances of a GLB file stand for far more numbers than it may hold."""
    magic, _, _, length, _ = struct.unpack("<5I", content[:20])
    if magic != int.from_bytes(b"glTF", "little"):
        raise InputError(path, value="contents that are no GLB", allowed=_ALLOWED)
    header = parse_json(content[20 : 20 + length], path)
    counts = [one["count"] * _COLUMNS[one["type"]] for one in header.get("accessors", [])]
    used = [0] * len(header.get("meshes", []))
    for number, mesh in enumerate(header.get("meshes", [])):
        for primitive in mesh["primitives"]:
            named = [*primitive.get("attributes", {}).values(), primitive.get("indices", -1)]
            used[number] += sum(counts[one] for one in named if one >= 0)
    nodes = header.get("nodes", [])
    instances = sum(used[node["mesh"]] for node in nodes if "mesh" in node)
    if len(nodes) > _MOST_NODES:
        raise InputError(path, value=f"{len(nodes)} nodes", allowed=f"{_MOST_NODES} at most")
    if any(count < 0 for count in counts) or sum(counts) + instances > _MOST_NUMBERS:
        value = f"{sum(counts)} numbers, {instances} with instances"
        raise InputError(path, value=value, allowed=f"{_MOST_NUMBERS} at most")
