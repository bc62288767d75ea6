"""Decorators that compile the numba kernels, and the care that their disk cache needs.

numba keeps compiled kernels beside their source files, but looks only at the file of the outermost function: a
change in a kernel that others call would leave those others stale. So the sources, and the modules that they import,
are hashed when the first kernel module is imported, and all cached kernels of a checkout go when the hash has changed.
"""

import contextlib
import hashlib
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from numba import njit, types

_PACKAGE = Path(__file__).resolve().parent
# Found by a pattern and not by parsing, as it runs whenever a kernel module is first imported.
_IMPORT = re.compile(rb"^from (pinwm_drake[\w.]*) import (\([^)]*\)|[^\n(]*)", re.MULTILINE)


def forget_stale_kernels(package: Path = _PACKAGE) -> bool:
    """Deletes the cached kernels of a package whose kernel sources have changed since they were compiled.

    Args:
        package: folder of the package; its `__pycache__` keeps the hash.

    Returns:
        Whether anything was forgotten. A folder that cannot be written is left alone: an installed package does not
        change file by file.
    """
    sources = {path: path.read_bytes() for path in sorted(package.rglob("*.py"))}
    kernels = {path for path in sources if b"pinwm_drake.jit" in sources[path] or path.name == "jit.py"}
    # What kernel modules import may hold constants, which are compiled into the kernels.
    imported = {name for path in kernels for name in _imported(sources[path])}
    digest = hashlib.sha256()
    for path, source in sources.items():
        name = ".".join(("pinwm_drake", *path.relative_to(package).with_suffix("").parts))
        if path in kernels or name.encode() in imported:
            digest.update(source)
    stamp = package / "__pycache__" / "kernels.sha256"
    try:
        if stamp.is_file() and stamp.read_text() == digest.hexdigest():
            return False
        stamp.parent.mkdir(exist_ok=True)
        for pattern in ("*.nbi", "*.nbc"):
            for path in package.rglob(f"__pycache__/{pattern}"):
                with contextlib.suppress(FileNotFoundError):
                    path.unlink()
        partial = stamp.with_suffix(f".{os.getpid()}.tmp")
        partial.write_text(digest.hexdigest())
        partial.replace(stamp)
    except OSError:
        return False
    return True


def _imported(source: bytes) -> Iterator[bytes]:
    """Dotted names of what a module may import from the package: modules, and names in them."""
    for module, names in _IMPORT.findall(source):
        yield module
        yield from (module + b"." + name for name in re.findall(rb"\w+", names))


forget_stale_kernels()


def _compiled(**options: Any) -> Callable[[Callable], Any]:
    """Decorator like `numba.njit` that compiles a kernel once for each type of its arguments.

    To numba, a number that is written in a call, or that a loop begins with, is a type of its own; it would compile the
    kernel, and all that it calls, for that number too, which doubles the time.
    """

    def decorate(function: Callable) -> Any:
        dispatcher = njit(**options)(function)
        if dispatcher is function:  # NUMBA_DISABLE_JIT
            return function
        resolve = dispatcher.get_call_template

        def get_call_template(args: tuple, kws: dict) -> Any:
            plain = {name: types.unliteral(value) for name, value in kws.items()}
            return resolve(tuple(types.unliteral(value) for value in args), plain)

        dispatcher.get_call_template = get_call_template
        return dispatcher

    return decorate


# Divisions follow IEEE (no exception), products may be contracted, the sign of zero does not matter. NaN and infinity
# keep their meaning everywhere: results are checked for them.
_EXACT = {"contract", "nsz", "arcp"}

# Most kernels are called by kernels only. They come without the wrappers through which Python would call them:
# unpacking a model's arrays there is more code than the kernels themselves, and half of the compile time.
_INTERNAL = {"cache": True, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

# And they come without numba's runtime (`_nrt=False`): they cannot allocate, and do not count references. Counting
# those of a model's arrays at every call takes longer than the geometry, and threads would fight for the counters.

# For the physics: sums may also be reordered, which is what lets short loops use vector instructions.
kernel = _compiled(**_INTERNAL, fastmath={*_EXACT, "reassoc"}, _nrt=False)

# For what is called for every contact or step: a call would hand over all arrays of a step, hundreds of numbers, which
# can take longer than what it does.
small_kernel = _compiled(**_INTERNAL, fastmath={*_EXACT, "reassoc"}, _nrt=False, forceinline=True)

# For what one kernel alone calls: it becomes a part of that one. Machine code is made anew for all that a kernel calls,
# at every level of calls, so that a level less is seconds less.
part_of_kernel = njit(cache=True, inline="always")

# For geometry, whose tie-breaks want sums in the order written.
internal_kernel = _compiled(**_INTERNAL, fastmath=_EXACT, _nrt=False)

# The same for geometry that Python calls too.
geometry_kernel = _compiled(cache=True, error_model="numpy", fastmath=_EXACT, _nrt=False)

# For the few kernels that allocate.
allocating_kernel = _compiled(**_INTERNAL, fastmath=_EXACT, _nrt=True)

# For entry points: they release Python's lock, so that threads can share worlds.
entry_point = njit(cache=True, nogil=True, error_model="numpy", fastmath=_EXACT)
