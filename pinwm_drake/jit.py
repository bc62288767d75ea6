# SPDX-License-Identifier: MIT
"""Decorators that compile the numba kernels, and the care that their disk cache needs.

numba keeps compiled kernels beside their source files, but looks only at the file of the outermost function: a
change in a kernel that others call would leave those others stale. So the sources, and the modules that they import,
are hashed when the first kernel module is imported, and all cached kernels of a checkout go when the hash has changed.
A cache elsewhere, as of an installed package that cannot be written to, has a folder for each hash.
"""

import contextlib
import hashlib
import logging
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba import njit, types
from numba.core import codegen, event
from numba.core.caching import _CacheLocator
from numba.core.compiler_lock import global_compiler_lock
from numba.misc.appdirs import AppDirs

COMPILING = "compiling kernels: one to three minutes of CPU, cached afterwards"
"""Line that a process logs once when it begins to compile; measured: 93 and 190 s of CPU on two machines."""
_TEMPORARY = "compiled kernels go to %s, for want of another place; set NUMBA_CACHE_DIR to a folder that lasts"
_log = logging.getLogger(__name__)
_WORKER = "PINWM_THREADS"  # `threads.LIMIT`: set in processes that are one of several, whose parent tells for all
entries: list[Any] = []
"""Dispatchers of the entry points of all modules that are loaded."""
# Releases whose compiler has the private parts that are replaced below; pyproject.toml says the same.
NUMBA = "0.68"
_PACKAGE = Path(__file__).resolve().parent
# Found by a pattern and not by parsing, as it runs whenever a kernel module is first imported.
_IMPORT = re.compile(rb"^from (pinwm_drake[\w.]*) import (\([^)]*\)|[^\n(]*)", re.MULTILINE)


def forget_stale_kernels(package: Path = _PACKAGE) -> bool:
    """Delete the cached kernels of a package whose kernel sources have changed since they were compiled.

    Args:
        package: folder of the package; its `__pycache__` keeps the hash.

    Returns:
        Whether anything was forgotten. A folder that cannot be written is left alone: an installed package does not
        change file by file.
    """
    stamp, digest = _stamp(package), _digest(package)
    try:
        if stamp.is_file() and stamp.read_text() == digest:
            return False
        stamp.parent.mkdir(exist_ok=True)
        for path in _cached(package):
            with contextlib.suppress(FileNotFoundError):
                path.unlink()
        partial = stamp.with_suffix(f".{os.getpid()}.tmp")
        partial.write_text(digest)
        partial.replace(stamp)
    except OSError:
        return False
    return True


def place_kernels(package: Path = _PACKAGE) -> Path | None:
    """Tell numba where compiled kernels go, where that is not beside their sources.

    The first that can be written to is taken: `NUMBA_CACHE_DIR`; beside the sources; the user's cache; a folder for
    temporary files, with a warning. Kernels that were compiled beside the sources are copied.

    Args:
        package: folder of the package.

    Returns:
        The folder; None for beside the sources.

    Raises:
        InputError: There is no folder that can be written to.
    """
    digest = _digest(package)
    name, users = f"pinwm-{digest[:16]}", AppDirs(appname="numba", appauthor=False).user_cache_dir
    given = numba.config.CACHE_DIR
    folder = _tried(Path(given) / name) if given else None
    if folder is None and _tried(package / "__pycache__") is not None:
        return None
    if folder is None and os.path.isabs(users):  # it is not, of a user without a home
        folder = _tried(Path(users) / name)
    if folder is None:
        folder = _temporary_folder(package) / name
        folder.mkdir(exist_ok=True)
        os.environ["NUMBA_CACHE_DIR"] = str(folder.parent)  # for other processes, which need not warn
    numba.config.CACHE_DIR = str(folder)
    with contextlib.suppress(OSError):
        if not any(folder.iterdir()) and _stamp(package).read_text() == digest:
            for path in _cached(package):
                target = folder / _CacheLocator.get_suitable_cache_subpath(str(path.parent))
                target.mkdir(exist_ok=True)
                shutil.copyfile(path, target / path.name)
    return folder


def _tried(folder: Path) -> Path | None:
    """Return a folder, made if need be; None where it cannot be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return None
    return folder


def _temporary_folder(package: Path) -> Path:
    """Return a folder for kernels that nobody else can write to, as they are code; tell of it."""
    from pinwm_drake.errors import InputError  # not above, as below

    try:
        folder = Path(tempfile.gettempdir()) / f"pinwm-kernels-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o022:
            folder = Path(tempfile.mkdtemp(prefix="pinwm-kernels-"))
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        allowed = "NUMBA_CACHE_DIR: a folder for compiled kernels that can be written to"
        raise InputError(package, value=f"no place for kernels ({error.strerror})", allowed=allowed) from error
    if _WORKER not in os.environ:
        _log.warning(_TEMPORARY, folder)
    return folder


def _stamp(package: Path) -> Path:
    return package / "__pycache__" / "kernels.sha256"


def _cached(package: Path) -> list[Path]:
    """Files of kernels that were compiled beside their sources."""
    return [path for pattern in ("*.nbi", "*.nbc") for path in package.rglob(f"__pycache__/{pattern}")]


def _digest(package: Path) -> str:
    """SHA-256 of all sources of kernels."""
    sources = {path: path.read_bytes() for path in sorted(package.rglob("*.py"))}
    kernels = {path for path in sources if b"pinwm_drake.jit" in sources[path] or path.name == "jit.py"}
    # What kernel modules import may hold constants, which are compiled into the kernels.
    imported = {name for path in kernels for name in _imported(sources[path])}
    digest = hashlib.sha256()
    for path, source in sources.items():
        name = ".".join(("pinwm_drake", *path.relative_to(package).with_suffix("").parts))
        if path in kernels or name.encode() in imported:
            digest.update(source)
    return digest.hexdigest()


def _imported(source: bytes) -> Iterator[bytes]:
    """Dotted names of what a module may import from the package: modules, and names in them."""
    for module, names in _IMPORT.findall(source):
        yield module
        yield from (module + b"." + name for name in re.findall(rb"\w+", names))


def require_numba(version: str) -> None:
    """Raise VersionError for a release of numba whose compiler may have other private parts."""
    from pinwm_drake.errors import VersionError  # not above, where a change of it would compile all kernels anew

    if version.split(".")[:2] != NUMBA.split("."):
        raise VersionError(
            f"numba: got version {version}; allowed: {NUMBA}.*, as `pip install 'numba=={NUMBA}.*'` has it"
        )


require_numba(numba.__version__)
forget_stale_kernels()
place_kernels()


class _Announcer(event.Listener):  # type: ignore[misc]
    """Listener that logs `COMPILING` once, when a kernel is compiled that is not in the cache."""

    def __init__(self) -> None:
        self._told = False

    def on_start(self, event: Any) -> None:
        function = getattr(event.data.get("dispatcher"), "py_func", None)
        if str(getattr(function, "__module__", "")).partition(".")[0] == "pinwm_drake":
            self.tell()

    def on_end(self, event: Any) -> None:
        pass

    def tell(self) -> None:
        if not self._told and _WORKER not in os.environ:
            _log.warning(COMPILING)
        self._told = True


announcer = _Announcer()
event.register("numba:compile", announcer)


_WHOLE = (codegen.JITCPUCodegen._library_class, codegen.JITCPUCodegen.set_env)


class _Part(codegen.JITCodeLibrary):  # type: ignore[misc]
    """Code that is only a part of other code: it is linked into that as it is, and optimised there.

    numba optimises every function, with all that it calls, and makes machine code of it. Of kernels that call each
    other six deep, that is the same work six times over, for code that is thrown away.
    """

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _LargePart(_Part):
    """A part that is not copied to where it is called, but called."""

    def add_llvm_module(self, ll_module: Any) -> None:
        for function in ll_module.functions:
            if not function.is_declaration:
                function.add_function_attribute("noinline")
        super().add_llvm_module(ll_module)


@contextlib.contextmanager
def _compiling(part: type | None) -> Iterator[None]:
    """Context in which numba compiles parts of other code, or whole entry points (None).

    It holds numba's own lock: another thread that compiles meanwhile would compile in the wrong way, and set back what
    this one needs.
    """
    code = codegen.JITCPUCodegen
    with global_compiler_lock:
        before = code._library_class, code.set_env
        # A part has no machine code whose environment could be set, and as it raises nothing it needs none.
        code._library_class, code.set_env = _WHOLE if part is None else (part, lambda self, name, value: None)
        try:
            yield
        finally:
            code._library_class, code.set_env = before


def _compiled(part: type | None = _Part, **options: Any) -> Callable[[Callable], Any]:
    """Return a decorator like `numba.njit` that compiles a kernel once for each type of its arguments.

    With None for the part, it compiles an entry point, which Python calls; what that calls in turn is part of it.

    To numba, a number that is written in a call, or that a loop begins with, is a type of its own; it would compile the
    kernel, and all that it calls, for that number too, which doubles the time.
    """

    def decorate(function: Callable) -> Any:
        dispatcher = njit(**options)(function)
        if dispatcher is function:  # NUMBA_DISABLE_JIT
            return function
        if part is None:
            entries.append(dispatcher)
        resolve, compile_ = dispatcher.get_call_template, dispatcher.compile

        def get_call_template(args: tuple, kws: dict) -> Any:
            plain = {name: types.unliteral(value) for name, value in kws.items()}
            return resolve(tuple(types.unliteral(value) for value in args), plain)

        def compile_part(signature: Any) -> Any:
            with _compiling(part):
                return compile_(signature)

        dispatcher.get_call_template = get_call_template
        dispatcher.compile = compile_part
        return dispatcher

    return decorate


# Divisions follow IEEE (no exception), products may be contracted, the sign of zero does not matter. NaN and infinity
# keep their meaning everywhere: results are checked for them.
_EXACT = {"contract", "nsz", "arcp"}

# Most kernels are called by kernels only. They come without the wrappers through which Python would call them:
# unpacking a model's arrays there is more code than the kernels themselves, and half of the compile time.
#
# `forceinline` is said of each: numba hands what is not said down from the caller for whose sake it compiles.
_INTERNAL: dict[str, Any] = {
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "forceinline": False,
}

# And they come without numba's runtime (`_nrt=False`): they cannot allocate, and do not count references. Counting
# those of a model's arrays at every call takes longer than the geometry, and threads would fight for the counters.

# For the physics: sums may also be reordered, which is what lets short loops use vector instructions.
kernel = _compiled(**_INTERNAL, fastmath={*_EXACT, "reassoc"}, _nrt=False)

# For what is called for every contact or step: a call would hand over all arrays of a step, hundreds of numbers, which
# can take longer than what it does.
small_kernel = _compiled(**{**_INTERNAL, "forceinline": True}, fastmath={*_EXACT, "reassoc"}, _nrt=False)

# For what is long, is called from several places, and is not called for every contact: there is one copy of it.
large_kernel = _compiled(_LargePart, **_INTERNAL, fastmath={*_EXACT, "reassoc"}, _nrt=False)
large_internal_kernel = _compiled(_LargePart, **_INTERNAL, fastmath=_EXACT, _nrt=False)

# For what one kernel alone calls: it becomes a part of that one. Machine code is made anew for all that a kernel calls,
# at every level of calls, so that a level less is seconds less.
part_of_kernel = njit(inline="always")

# For geometry, whose tie-breaks want sums in the order written.
internal_kernel = _compiled(**_INTERNAL, fastmath=_EXACT, _nrt=False)

# For the few kernels that allocate.
allocating_kernel = _compiled(**_INTERNAL, fastmath=_EXACT, _nrt=True)

# For entry points: they release Python's lock, so that threads can share worlds.
entry_point = _compiled(None, cache=True, nogil=True, error_model="numpy", fastmath=_EXACT)
