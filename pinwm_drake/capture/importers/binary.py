"""Binary file read from its start; one that ends too soon is refused."""

import struct
from pathlib import Path
from typing import Any

from pinwm_drake.capture.paths import require_file
from pinwm_drake.errors import InputError


class Binary:
    """Bytes of a file, little-endian and without padding, and the place up to which they have been read."""

    def __init__(self, path: Path) -> None:
        """Reads a file; raises InputError where that fails."""
        require_file(path, "a binary file")
        self._path = path
        self._at = 0
        try:
            self._data = path.read_bytes()
        except OSError as error:
            raise InputError(path, value=error.strerror, allowed="a file that can be read") from error

    def count(self, code: str) -> int:
        """The number of records that the file says it has; no more than it has bytes."""
        (count,) = self.take(code, None)
        return min(int(count), len(self._data) + 1)

    def take(self, code: str, row: int | None) -> tuple[Any, ...]:
        """Takes the next values, by their `struct` format.

        Args:
            code: Without its byte order.
            row: Number of the record, for messages.

        Raises:
            InputError: The file ends before.
        """
        layout = struct.Struct(f"<{code}")
        self._require(layout.size, row)
        values = layout.unpack_from(self._data, self._at)
        self._at += layout.size
        return values

    def text(self, row: int | None) -> str:
        """The next text in UTF-8, which a zero byte ends; raises InputError as `take` does."""
        end = self._data.find(b"\0", self._at)
        if end < 0:
            self._require(len(self._data) - self._at + 1, row)
        text = self._data[self._at : end].decode("utf-8", errors="backslashreplace")
        self._at = end + 1
        return text

    def skip(self, size: int, row: int | None) -> None:
        """Leaves out some bytes; raises InputError as `take` does."""
        self._require(size, row)
        self._at += size

    def _require(self, size: int, row: int | None) -> None:
        if self._at + size > len(self._data):
            found = f"a file that ends after {len(self._data)} bytes"
            raise InputError(self._path, row=row, value=found, allowed="a whole file (the row is the record's number)")
