# SPDX-License-Identifier: MIT
"""Arrays of npz files without pickles; the sizes that a file announces are checked before anything is allocated."""

import io
import math
import zipfile
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np
from numpy.lib import format as npy

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import MOST_BYTES, guarded, opened

_MOST_MEMBERS, _MOST_HEADER = 10_000, 10_000
_MOST_RATIO = 1032  # of deflate, by its format
_CHUNK = 2**20  # bytes
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1
_LAST_CHARACTER, _SURROGATES = 0x10FFFF, (0xD800, 0xDFFF)


def read_npz(path: Path, allowed: str, *, most: int = MOST_BYTES) -> dict[str, np.ndarray]:
    """Read all arrays of an npz file: flags, numbers and text, in the byte order of this machine.

    Args:
        path: The file.
        allowed: What was expected, for messages.
        most: Largest sum of the arrays' sizes, bytes.

    Raises:
        InputError: It is no regular file, no such archive, damaged or encrypted, holds anything else than arrays,
            or announces more than it may.
    """
    with guarded(path, allowed), opened(path) as file:
        return _arrays(file, path, allowed, most)


def parse_npz(content: bytes, path: Path, allowed: str, *, most: int = MOST_BYTES) -> dict[str, np.ndarray]:
    """Return all arrays of the contents of an npz file; see `read_npz`."""
    with guarded(path, allowed):
        return _arrays(io.BytesIO(content), path, allowed, most)


def _arrays(file: BinaryIO, path: Path, allowed: str, most: int) -> dict[str, np.ndarray]:
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    arrays: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(file) as archive:
        entries = archive.infolist()
        if len(entries) > _MOST_MEMBERS:
            raise InputError(path, value=f"{len(entries)} arrays", allowed=f"{_MOST_MEMBERS} at most")
        if (total := sum(entry.file_size for entry in entries)) > most:
            raise InputError(path, value=f"arrays of {total} bytes", allowed=f"{most} bytes at most")
        if sum(entry.compress_size for entry in entries) > size:
            raise InputError(path, value="entries that overlap, or are cut off", allowed=allowed)
        for entry in entries:
            name = entry.filename.removesuffix(".npy")
            if entry.flag_bits & _ENCRYPTED or entry.compress_type not in _METHODS:
                raise InputError(path, value=f"{name!r}, encrypted or of another compression", allowed=allowed)
            if entry.file_size > _MOST_RATIO * (entry.compress_size + 1) or name in arrays:
                raise InputError(path, value=f"{name!r} of {entry.file_size} bytes, or twice", allowed=allowed)
            with archive.open(entry) as member:
                arrays[name] = _array(member, entry.file_size, path, name)
    return arrays


def _array(member: IO[bytes], size: int, path: Path, name: str) -> np.ndarray:
    version = npy.read_magic(member)
    if version not in _HEADERS:
        raise InputError(path, value=f"{name!r} of version {version}", allowed="arrays of version 1.0 or 2.0")
    shape, by_columns, dtype = _HEADERS[version](member, max_header_size=_MOST_HEADER)
    found = f"{name!r} of {dtype} {shape}"
    if dtype.kind not in "biufcUS" or not dtype.isnative or not dtype.itemsize:
        raise InputError(path, value=found, allowed="flags, numbers or text, no pickles")
    if any(length < 0 for length in shape) or math.prod(shape) * dtype.itemsize != size - member.tell():
        raise InputError(path, value=f"{found} in {size} bytes", allowed="a whole array")
    flat = np.empty(math.prod(shape) * dtype.itemsize, np.uint8)
    at = 0
    while chunk := member.read(_CHUNK):  # to the end, where its checksum is compared
        flat[at : at + len(chunk)] = np.frombuffer(chunk, np.uint8)
        at += len(chunk)
    if at != len(flat):
        raise InputError(path, value=f"{found}, cut off", allowed="a whole array")
    if dtype.kind == "U":
        codes, (first, last) = flat.view(np.uint32), _SURROGATES
        if (codes > _LAST_CHARACTER).any() or ((codes >= first) & (codes <= last)).any():
            raise InputError(path, value=f"{name!r} with codes that are no characters", allowed="text")
    array: np.ndarray = flat.view(dtype).reshape(shape, order="F" if by_columns else "C")
    return array
