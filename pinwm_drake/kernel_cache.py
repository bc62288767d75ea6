# SPDX-License-Identifier: MIT
"""The cache of compiled kernels on disk: where it is, and how much of it is there.

Other modules than those of kernels ask here: what imports `pinwm_drake.jit` counts as a source of kernels, of which a
change lets all of them be compiled anew.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from pinwm_drake import jit

COMPILING = jit.COMPILING


@dataclass(frozen=True)
class KernelCache:
    """State of numba's cache of compiled kernels.

    Attributes:
        folders: Folders that hold it, beside the sources or where numba puts it.
        compiled: Number of entry points that are in it.
        entries: Number of entry points of the modules that are loaded.
        writable: Flag: kernels can be added.
    """

    folders: tuple[Path, ...]
    compiled: int
    entries: int
    writable: bool


def kernel_cache() -> KernelCache:
    """Look at the cache of the kernels whose modules are loaded; nothing is compiled."""
    where = {entry: Path(entry.stats.cache_path) for entry in jit.entries if entry.stats.cache_path}
    names = {entry: f"{entry.py_func.__module__.rpartition('.')[2]}.{entry.py_func.__name__}-" for entry in where}
    compiled = sum(any(folder.glob(f"{names[entry]}*.nbi")) for entry, folder in where.items())
    folders = tuple(sorted(set(where.values())))
    writable = bool(folders) and all(_writable(folder) for folder in folders)
    return KernelCache(folders, compiled, len(jit.entries), writable)


def _writable(folder: Path) -> bool:
    """Flag: files can be made in a folder, or the folder itself in the nearest one that is there."""
    while not folder.exists():
        folder = folder.parent
    return os.access(folder, os.W_OK | os.X_OK)


def announce_compiling() -> None:
    """Log `COMPILING` where hardly any kernel is cached; for work that other processes do, which do not tell."""
    found = kernel_cache()
    if found.compiled * 2 < found.entries:
        jit.announcer.tell()
