"""The vertices of a PLY file as a table.

Source: Turk, "The PLY Polygon File Format", 1994. Our own because the well-kept reader, plyfile, is under the GPL.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinwm_drake.errors import InputError

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_END = b"end_header"
_MOST_HEADER = 1 << 20  # bytes


@dataclass(frozen=True)
class Property:
    """A column: its name, numpy type (None for a list), and its line in the header."""

    name: str
    kind: str | None
    line: str


@dataclass(frozen=True)
class Vertices:
    """The vertices that a header announces.

    Attributes:
        path: the file.
        count: number of rows.
        properties: the columns by name.
    """

    path: Path
    count: int
    properties: dict[str, Property]
    _form: str
    _skipped: tuple[tuple[int, tuple[Property, ...]], ...]  # count and columns of the elements before
    _body: bytes

    @staticmethod
    def open(path: Path) -> "Vertices":
        """Reads the header of a PLY file.

        Raises:
            InputError: The file cannot be read, is no PLY, or has no element 'vertex'.
        """
        try:
            contents = path.read_bytes()
        except OSError as error:
            raise InputError(path, value=error.strerror or str(error), allowed="a file that can be read") from error
        end = contents.find(_END, 0, _MOST_HEADER)
        if not contents.startswith(b"ply") or end < 0:
            raise _unreadable(path, "no header from 'ply' to 'end_header'")
        lines = contents[:end].decode("latin-1").splitlines()
        body = contents[end + len(_END) :]
        body = body[2:] if body[:2] == b"\r\n" else body[1:]
        form, elements = "", list[tuple[str, int, list[Property]]]()
        for number, line in enumerate(lines[1:], 2):
            words = line.split()
            if not words or words[0] in ("comment", "obj_info"):
                continue
            if words[0] == "format" and len(words) == 3 and words[1] in _ORDERS:
                form = words[1]
            elif words[0] == "element" and len(words) == 3 and words[2].isdecimal():
                elements.append((words[1], int(words[2]), []))
            elif words[0] == "property" and elements and len(words) == 3 and words[1] in _TYPES:
                elements[-1][2].append(Property(words[2], _TYPES[words[1]], " ".join(words)))
            elif words[:2] == ["property", "list"] and elements and len(words) == 5:
                elements[-1][2].append(Property(words[4], None, " ".join(words)))
            else:
                raise _unreadable(path, f"header line {number}: {line!r}")
        if not form:
            raise _unreadable(path, "a header without a known format")
        names = [name for name, _, _ in elements]
        if "vertex" not in names:
            found = ", ".join(names) or "no element"
            raise InputError(path, value=f"a PLY with {found}", allowed="a PLY with an element 'vertex'")
        place = names.index("vertex")
        skipped = tuple((count, tuple(columns)) for _, count, columns in elements[:place])
        _, count, columns = elements[place]
        return Vertices(path, count, {item.name: item for item in columns}, form, skipped, body)

    def rows(self) -> np.ndarray:
        """Structured array (count,) of the vertices; no column may be a list.

        Raises:
            InputError: The file is truncated or holds something else than numbers.
        """
        if any(item.kind is None for _, columns in self._skipped for item in columns):
            raise _unreadable(self.path, "a list before the vertices")
        kinds = np.dtype([(name, _ORDERS[self._form] + str(item.kind)) for name, item in self.properties.items()])
        if self._form == "ascii":
            return self._text_rows(kinds)
        first = sum(count * sum(int(str(item.kind)[1:]) for item in columns) for count, columns in self._skipped)
        available = max(len(self._body) - first, 0) // max(kinds.itemsize, 1)
        if available < self.count:
            raise self._truncated(available)
        return np.frombuffer(self._body, kinds, self.count, first)

    def _text_rows(self, kinds: np.dtype) -> np.ndarray:
        lines = [line for line in self._body.decode("latin-1").splitlines() if line.strip()]
        lines = lines[sum(count for count, _ in self._skipped) :]
        if len(lines) < self.count:
            raise self._truncated(len(lines))
        rows = np.empty(self.count, kinds)
        for i, line in enumerate(lines[: self.count]):
            try:
                rows[i] = tuple(float(word) for word in line.split())
            except ValueError as error:
                value = f"unreadable contents ({line.strip()[:60]!r})"
                raise InputError(
                    self.path, row=i + 1, value=value, allowed=f"{len(self.properties)} numbers"
                ) from error
        return rows

    def _truncated(self, found: int) -> InputError:
        value = f"a truncated file ({found} of {self.count} vertices)"
        return InputError(self.path, value=value, allowed="a whole PLY file")


def write_vertices(path: Path, names: tuple[str, ...], columns: np.ndarray) -> None:
    """Writes columns (N, len(names)) as float32 vertices of a binary PLY file; raises OSError."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(columns)}"]
    header += [f"property float {name}" for name in names]
    with open(path, "wb") as file:
        file.write("\n".join([*header, _END.decode(), ""]).encode())
        file.write(np.ascontiguousarray(columns, "<f4").tobytes())


def _unreadable(path: Path, what: str) -> InputError:
    return InputError(path, value=f"unreadable contents ({what})", allowed="a PLY file of surfels")
