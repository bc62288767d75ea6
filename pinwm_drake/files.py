# SPDX-License-Identifier: MIT
"""Output folders that are checked before use, and output files that appear whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pinwm_drake.errors import InputError


def prepare_folder(folder: Path) -> Path:
    """Make an output folder and try whether it takes files.

    Args:
        folder: Folder that results are to go to; parents are made too.

    Returns:
        The folder.

    Raises:
        InputError: When it cannot be made or written to, or is a file.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(folder, value=error.strerror, allowed="a folder that can be written to") from error
    return folder


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Hands out a temporary name beside `path`, and renames it to `path` when the block ends well.

    A reader never sees half a file, and a failed run leaves the earlier file as it was.

    Args:
        path: The final name. Its folder exists.

    Yields:
        The name to write to, with the same suffix.

    Raises:
        InputError: When the file cannot be written or renamed.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise InputError(path, value=error.strerror or str(error), allowed="a file that can be written") from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def appearing(out: Path) -> Iterator[Path]:
    """Hands out a folder beside `out`, which takes its name when the block ends well, and is removed otherwise.

    Args:
        out: The final name: nothing yet, or an empty folder. Parents are made.

    Yields:
        The folder to write to.

    Raises:
        InputError: `out` is a link, a file or a folder that holds something, or cannot be made or written to.
    """
    whole, allowed = out.absolute(), "a folder that can be written to"
    temporary = whole.parent / f".{whole.name}.{os.getpid()}"
    try:
        if out.is_symlink() or (out.exists() and (not out.is_dir() or any(out.iterdir()))):
            raise InputError(out, value="something there already", allowed="a new or empty folder")
        temporary.mkdir(parents=True)
        yield temporary
        allowed = "a new or empty folder"
        temporary.replace(whole)
    except OSError as error:
        raise InputError(out, value=error.strerror or str(error), allowed=allowed) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
