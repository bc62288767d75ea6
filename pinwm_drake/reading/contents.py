# SPDX-License-Identifier: MIT
"""Contents of regular files of a limited size, and the one line that stands for any failure to read them."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from pinwm_drake.errors import InputError, PinwmError

MOST_BYTES = 2**30  # of any file
MOST_TEXT = 2**26  # bytes of a text
_CAN_BE_READ = "a file that can be read"


@contextmanager
def guarded(path: str | os.PathLike[str], allowed: str) -> Iterator[None]:
    """Turns whatever a parser raises into an InputError; errors of the package pass.

    Args:
        path: Path that the message names.
        allowed: What was expected, in words.

    Raises:
        InputError: The block raised something else, a lack of memory or a recursion too deep included.
    """
    try:
        yield
    except PinwmError:
        raise
    except Exception as error:
        words = str(error).strip() or type(error).__name__
        raise InputError(path, value=f"unreadable contents ({words})", allowed=allowed) from error


@contextmanager
def opened(path: Path, most: int = MOST_BYTES) -> Iterator[BinaryIO]:
    """Opens a regular file for reading; links are followed.

    Args:
        path: The file.
        most: Largest size, bytes.

    Raises:
        InputError: It is missing, a folder, device, pipe or socket, too large, or may not be read.
    """
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):  # opening a device may do something
            raise _no_file(path)
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe without a writer would block
    except OSError as error:
        raise InputError(path, value=error.strerror, allowed=_CAN_BE_READ) from error
    except ValueError as error:  # a NUL in its name
        raise InputError(path, value=error, allowed=_CAN_BE_READ) from error
    with os.fdopen(descriptor, "rb") as file:
        about = os.fstat(descriptor)
        if not stat.S_ISREG(about.st_mode):  # it took the place of the file that was looked at
            raise _no_file(path)
        if about.st_size > most:
            raise _too_large(path, about.st_size, most)
        yield file


def require_contents(path: Path, most: int) -> Path:
    """Return the path of a regular file that holds something, for a library that opens it by its name.

    Raises:
        InputError: As for `opened`, or it is empty or gives nothing without waiting.
    """
    with guarded(path, _CAN_BE_READ), opened(path, most) as file:
        if not file.read(1):
            raise InputError(path, value="no contents", allowed=_CAN_BE_READ)
    return path


def read_bytes(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the contents of a regular file of `most` bytes or less.

    Raises:
        InputError: As for `opened`.
    """
    with opened(path, most) as file:
        try:
            content: bytes | None = file.read(most + 1)  # files of /proc tell no size
        except OSError as error:
            raise InputError(path, value=error.strerror, allowed=_CAN_BE_READ) from error
    if content is None:  # nothing to be had without waiting, as from /proc/kmsg
        raise _no_file(path)
    if len(content) > most:
        raise _too_large(path, len(content), most)
    return content


def read_text(path: Path, most: int = MOST_TEXT) -> str:
    """Return the text of a regular file in UTF-8, without a byte-order mark.

    Raises:
        InputError: As for `opened`, or it is in another encoding.
    """
    return as_text(read_bytes(path, most), path)


def as_text(content: bytes, path: Path) -> str:
    """Return the text of contents in UTF-8, without a byte-order mark; lines end as in Python.

    Raises:
        InputError: It is in another encoding; the message names the byte.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, value=f"a byte that is not text at {error.start}", allowed="text in UTF-8") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _no_file(path: Path) -> InputError:
    value = "a folder" if path.is_dir() else "something that is no file"
    return InputError(path, value=value, allowed=_CAN_BE_READ)


def _too_large(path: Path, size: int, most: int) -> InputError:
    return InputError(path, value=f"{size} bytes or more", allowed=f"{most} bytes at most")
