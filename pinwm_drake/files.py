# SPDX-License-Identifier: MIT
"""Output folders that are checked before use, and output files that appear whole or not at all.

Temporary names carry host, process and a random part, so that a later process can remove what a dead one left.
"""

import os
import re
import secrets
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pinwm_drake.errors import InputError

LOCK_FILE = ".pinwm.lock"
_TEMPORARY = re.compile(r"(?:\..*|pinwm)~([^~]+)~([0-9]{1,9})~[a-z0-9_]{8}(?:\.[^~]*)?", re.DOTALL)
_LONGEST_STEM = 30  # characters; names may have 255 bytes
_swept: set[Path] = set()  # folders whose leftovers this process has removed
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_swept.clear)


def prepare_folder(folder: Path) -> Path:
    """Make an output folder, try whether it takes files, and remove what dead processes left in it.

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
    remove_leftovers(folder)
    return folder


@contextmanager
def occupying(folder: Path) -> Iterator[Path]:
    """Make an output folder, and keep other runs out of it until the block ends.

    A run may occupy a folder again within itself. The lock of a process that is dead is taken over.

    Args:
        folder: Folder that results are to go to; parents are made too.

    Yields:
        The folder.

    Raises:
        InputError: Another run occupies it; or see `prepare_folder`.
    """
    from filelock import SoftFileLock, Timeout

    lock = SoftFileLock(prepare_folder(folder).resolve() / LOCK_FILE, timeout=0, is_singleton=True)
    try:
        lock.acquire()
    except Timeout as error:
        raise InputError(folder, value=f"a run at work in it ({_owner(folder)})", allowed=_ELSEWHERE) from error
    except OSError as error:
        raise InputError(folder, value=error.strerror, allowed="a folder that can be written to") from error
    try:
        yield folder
    finally:
        with suppress(OSError):  # the folder is gone
            lock.release()


_ELSEWHERE = "another folder, or the end of that run"


def _owner(folder: Path) -> str:
    """Process and host that a lock names, in words."""
    try:
        process, host, *_ = (folder / LOCK_FILE).read_text(encoding="utf-8").split("\n")
    except (OSError, ValueError):
        return "it ends just now"
    return f"process {process} on {host}"


def remove_leftovers(folder: Path) -> None:
    """Remove temporary files of dead processes of this host from a folder, once in the life of this process.

    Those of the living, and of other hosts, stay. A container with process numbers of its own counts as a host.
    """
    folder = folder.absolute()
    if folder in _swept:
        return
    _swept.add(folder)
    with suppress(OSError):
        for entry in os.scandir(folder):
            found = _TEMPORARY.fullmatch(entry.name)
            if found and found[1] == _host() and not _lives(int(found[2])):
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    with suppress(OSError):
                        os.unlink(entry.path)


def _host() -> str:
    """Name of this host, with that of the namespace in which its process numbers count."""
    namespace = "0"
    with suppress(OSError):
        namespace = f"{os.stat('/proc/self/ns/pid').st_ino:x}"
    return f"{re.sub('[^A-Za-z0-9.-]', '_', socket.gethostname())[:64]}_{namespace}"


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # of another user
        pass
    return True


def _temporary(path: Path, suffix: str = "") -> Path:
    """Name beside a path that no other process, thread or host uses."""
    stem = path.name.removesuffix(suffix)[:_LONGEST_STEM]
    return path.with_name(f".{stem}~{_host()}~{os.getpid()}~{secrets.token_hex(4)}{suffix}")


def scratch() -> tempfile.TemporaryDirectory[str]:
    """Folder for temporary files, which goes with the object; what dead processes left beside it is removed.

    Raises:
        InputError: No folder for temporary files can be written to.
    """
    try:
        remove_leftovers(Path(tempfile.gettempdir()))
        return tempfile.TemporaryDirectory(prefix=f"pinwm~{_host()}~{os.getpid()}~", ignore_cleanup_errors=True)
    except OSError as error:
        raise InputError(
            "TMPDIR", value=error.strerror or str(error), allowed="a folder that can be written to"
        ) from error


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
    remove_leftovers(path.parent)
    temporary = _temporary(path, path.suffix)
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise InputError(path, value=error.strerror or str(error), allowed="a file that can be written") from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def appearing(out: Path, aside: Path | None = None) -> Iterator[Path]:
    """Hands out a folder beside `out`, which takes its name when the block ends well, and is removed otherwise.

    Args:
        out: The final name: nothing yet, or an empty folder. Parents are made.
        aside: New name that an earlier folder at `out` takes just before; None to refuse one that holds something.

    Yields:
        The folder to write to.

    Raises:
        InputError: `out` is a link, a file or a folder that holds something, or cannot be made or written to.
    """
    whole, allowed = out.absolute(), "a folder that can be written to"
    remove_leftovers(whole.parent)
    temporary = _temporary(whole)
    try:
        holds = out.exists() and (not out.is_dir() or any(out.iterdir()))
        if out.is_symlink() or (holds and (aside is None or not out.is_dir())):
            raise InputError(out, value="something there already", allowed="a new or empty folder")
        temporary.mkdir(parents=True)
        yield temporary
        if holds and aside is not None:
            aside.parent.mkdir(parents=True, exist_ok=True)
            whole.replace(aside)
        allowed = "a new or empty folder"
        temporary.replace(whole)
    except OSError as error:
        raise InputError(out, value=error.strerror or str(error), allowed=allowed) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
