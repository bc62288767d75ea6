# SPDX-License-Identifier: MIT
"""Completion of values in the shell: folders and files of the project's formats, and the names that ship."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

# Files that tell a folder's format.
_MARKS = {"twin": "twin.yaml", "policy": "policy.yaml", "bundle": "contract.yaml", "capture": "capture.yaml"}
_DEEPEST = 3  # folders below the one that is typed
_MOST = 200  # folders that are looked into


def completer(kind: str, choices: tuple[str, ...]) -> Callable[[str], list[str]]:
    """Return the function that gives the values of a kind that begin with a text.

    Args:
        kind: "twin", "scene", "policy", "bundle", "capture", "choice" or "".
        choices: Values of a choice.
    """

    def complete(incomplete: str) -> list[str]:
        found = [*choices, *_shipped(kind)]
        if kind in ("twin", "policy", "bundle", "capture", "scene"):
            found += _folders(kind, incomplete)
        return [one for one in found if one.startswith(incomplete)]

    return complete


def _shipped(kind: str) -> list[str]:
    """Names that ship with the package."""
    from pinwm_drake import models

    if kind in ("policy", "bundle"):
        return [*models.shipped_policies(), *(["mpc", "random"] if kind == "policy" else [])]
    return list(models.shipped_scenarios()) if kind in ("scene", "twin") else []


def _folders(kind: str, incomplete: str) -> Iterator[str]:
    """Paths of folders of a format, and of scenario files, that begin with a text."""
    head = os.path.dirname(incomplete)
    start, left = Path(head or "."), _MOST
    marks = {"scene": ("twin.yaml",), "policy": ("policy.yaml", "contract.yaml")}.get(kind, (_MARKS.get(kind, ""),))
    queue = [(start, 0)]
    while queue and left:
        folder, depth = queue.pop(0)
        left -= 1
        try:
            entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
        except OSError:
            continue
        for entry in entries:
            path = Path(folder, entry.name)
            if kind == "scene" and entry.name.endswith(".scenario.yaml"):
                yield str(path)
            if entry.is_dir() and not entry.name.startswith("."):
                if any((path / mark).is_file() for mark in marks):
                    yield str(path)
                elif depth + 1 < _DEEPEST:
                    queue.append((path, depth + 1))
