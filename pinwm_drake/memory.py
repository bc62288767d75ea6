# SPDX-License-Identifier: MIT
"""Memory of the machine, and of the control groups of this process."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

CGROUPS = Path("/sys/fs/cgroup")
# Of version 2 and 1 of control groups: the folder, the names of limit and use, and that of cached files in memory.stat.
_VERSIONS = (
    ("", "memory.max", "memory.current", "inactive_file"),
    ("memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)


def memory(root: Path = CGROUPS, groups: Path = Path("/proc/self/cgroup")) -> tuple[float, float]:
    """Total and free memory of this process, by the machine and by its control groups.

    Args:
        root: Folder of the control groups.
        groups: File with those of the process, whose parents count as well.

    Returns:
        Bytes; zeros where the system does not tell.
    """
    machine = _amounts(Path("/proc/meminfo"))
    total, free = 1024.0 * machine.get("MemTotal", 0.0), 1024.0 * machine.get("MemAvailable", 0.0)
    for folder, limit, used, cached in _VERSIONS:
        for group in _groups(root / folder, groups):
            with suppress(OSError, ValueError):  # "max" is no number
                most = float((group / limit).read_text())
                taken = float((group / used).read_text()) - _amounts(group / "memory.stat").get(cached, 0.0)
                if most < total:
                    total, free = most, min(free, most - taken)
    return total, free


def _amounts(file: Path) -> dict[str, float]:
    """Numbers of a file with a name and a number on each line."""
    found: dict[str, float] = {}
    with suppress(OSError, ValueError):
        for line in file.read_text().splitlines():
            name, number, *_ = line.split()
            found[name.rstrip(":")] = float(number)
    return found


def _groups(root: Path, groups: Path) -> Iterator[Path]:
    """Folders of control groups: the root, then those down to the process's own."""
    yield root
    with suppress(OSError):
        for line in groups.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if controllers in ("", "memory"):
                yield from (root.joinpath(*path.strip("/").split("/")[:k]) for k in range(1, path.count("/") + 1))
