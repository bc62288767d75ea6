# SPDX-License-Identifier: MIT
"""Checks that a file which another file names is there, and can be opened."""

import os
from pathlib import Path

from pinwm_drake.errors import InputError


def is_file(path: Path) -> bool:
    """Flag: a path is a file that may be read; false too for names that no file can have."""
    try:
        return path.is_file() and os.access(path, os.R_OK)
    except (OSError, ValueError):  # too long a name, a folder that may not be entered, a NUL
        return False


def is_folder(path: Path) -> bool:
    """Flag: a path is a folder that may be listed; false too for names that no folder can have."""
    try:
        return path.is_dir() and os.access(path, os.R_OK | os.X_OK)
    except (OSError, ValueError):
        return False


def require_file(path: Path, allowed: str) -> Path:
    """Return validated path of a file that can be read; `allowed` says in words which file should be there.

    Raises:
        InputError: It is missing, a folder, or may not be read.
    """
    if not is_file(path):
        raise InputError(path, value=_reason(path), allowed=allowed)
    return path


def _reason(path: Path) -> str:
    try:
        if path.is_dir():
            return "a folder"
        return "a file that may not be read" if path.exists() else "no such file"
    except (OSError, ValueError):
        return "no such file, or one that may not be read"
