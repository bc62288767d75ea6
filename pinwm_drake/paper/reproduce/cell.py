# SPDX-License-Identifier: MIT
"""Cells of an experiment: each is made once, in a folder of its own, and is not made again."""

import json
import os
import platform
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import torch
from filelock import FileLock

from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.provenance import timestamp, versions
from pinwm_drake.reading.contents import read_text
from pinwm_drake.reading.trees import MOST_JSON, no_infinite, parse_json

DONE_FILE = "done.json"
_LOGS = "logs"
_PERIOD = 30.0  # s, between two notes of a run
_RUNS = ".runs.json"
_LIBRARIES = ("drake", "gymnasium", "numba", "numpy", "stable-baselines3", "torch")
_WRITTEN = "a file that `pinwm reproduce` wrote"
Say = Callable[[str], None]
"""Called with a line on the progress of a cell."""


@dataclass(frozen=True)
class Cell:
    """Something that is made once; a frozen dataclass whose fields are its settings, plain data or other cells.

    Attributes:
        path: Path of its folder from the root of the experiment, with attributes in braces as of `self`.
        times: Estimates of the time that it takes, h of one core: of a quick one, and of others.
    """

    path: ClassVar[str]
    times: ClassVar[tuple[float, float]]

    @property
    def key(self) -> str:
        """Path of its folder from the root of the experiment."""
        return self.path.format(self=self)

    @property
    def needs(self) -> "tuple[Cell, ...]":
        """Cells that have to be made before: those among its settings, and what these need."""
        values = (getattr(self, one.name) for one in fields(self))
        own = [value for value in values if isinstance(value, Cell)]
        return tuple(dict.fromkeys(cell for one in own for cell in (one, *one.needs)))

    @property
    def quick(self) -> bool:
        """Flag: hardly anything is done; that of the cells that it needs."""
        return any(cell.quick for cell in self.needs)

    @property
    def hours(self) -> float:
        """Estimate of the time that it takes, h of one core."""
        return self.times[0 if self.quick else 1]

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Make it in `root / key`, where a run that was killed may have left what it had.

        Args:
            root: Folder of the experiment, with the cells that it needs.
            say: Called with lines on the progress.

        Returns:
            Result as plain data, which tables read.

        Raises:
            PinwmError: An input was refused, or a file cannot be written.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class CellStore:
    """Results of cells under a folder: what is there is not made again. It serves as a `Store` of an `Executor`."""

    root: Path

    def read(self, cell: Cell) -> dict[str, Any] | None:
        """Return the result of a cell with its provenance; None where it is not made yet.

        Raises:
            InputError: The folder holds a cell of other settings, of which the message names the first one, or its file
                cannot be read.
        """
        path = self.root / cell.key / DONE_FILE
        done: dict[str, Any] | None = _read_json(path)
        if done is None:
            return None
        parts = [done.get(name) if isinstance(done, dict) else None for name in ("settings", "result", "provenance")]
        if not all(isinstance(part, dict) for part in parts):
            raise InputError(path, value="no settings, result and provenance", allowed=_WRITTEN)
        if other := _other_setting(cell, parts[0]):
            allowed = "the options that it was made with, or another folder"
            raise InputError(path, value=f"a cell of other settings ({other})", allowed=allowed)
        return done

    def write(self, cell: Cell, result: Mapping[str, Any]) -> None:
        """Keep the result of a cell, which is so made."""
        _write_json(self.root / cell.key / DONE_FILE, result)
        log_path(self.root, cell, _RUNS).unlink(missing_ok=True)

    def holding(self, cell: Cell) -> AbstractContextManager[object]:
        """Context that one process at a time is in for a cell, of all that share the folder; others wait."""
        path = log_path(self.root, cell, ".lock")
        prepare_folder(path.parent)
        return FileLock(path)


def log_path(root: Path, cell: Cell, suffix: str) -> Path:
    """File on the making of a cell; not in its own folder, which the cell may have to be the first to write to."""
    return root / _LOGS / f"{cell.key.replace('/', '_')}{suffix}"


def made(cell: Cell, root: Path, say: Say) -> dict[str, Any]:
    """Make a cell, and tell with its result how, where and in what time, all runs together.

    A run notes itself in the folder of logs every half a minute, and when it fails, so that one that was killed counts.
    Where there were several, the provenance lists them as `runs`; `CellStore.write` removes the notes.

    Raises:
        PinwmError: See `Cell.make`; or the notes of earlier runs cannot be read.
    """
    path = log_path(root, cell, _RUNS)
    begun, cpu, here = time.monotonic(), time.process_time(), {"commit": commit(), "machine": _machine()}
    earlier = _read_runs(path)

    def runs() -> list[dict[str, Any]]:
        minutes, cpu_minutes = (time.monotonic() - begun) / 60.0, (time.process_time() - cpu) / 60.0
        spent = {"minutes": round(minutes, 2), "cpu_minutes": round(cpu_minutes, 2)}
        return [*earlier, {"time": timestamp(), **spent, **here}]

    with _every(_PERIOD, lambda: _write_json(path, runs())):
        result = dict(cell.make(root, say))
    found = runs()
    total = {name: round(sum(run[name] for run in found), 2) for name in ("minutes", "cpu_minutes")}
    several = {"runs": found} if earlier else {}
    provenance = {**found[-1], **total, "versions": versions(_LIBRARIES), **several}
    return {"settings": settings_of(cell), "result": result, "provenance": provenance}


@contextmanager
def _every(period: float, note: Callable[[], None]) -> Iterator[None]:
    """Call a function now and then while a block runs, and once more when that fails or ends."""
    ended = threading.Event()

    def now() -> None:
        with suppress(InputError):  # a note that cannot be written is no reason to stop
            note()

    def keep() -> None:
        while not ended.wait(period):
            now()

    thread = threading.Thread(target=keep, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        now()


def _read_runs(path: Path) -> list[dict[str, Any]]:
    earlier = _read_json(path)
    if earlier is None:
        return []
    try:
        [run["minutes"] + run["cpu_minutes"] for run in earlier]
    except (TypeError, KeyError) as error:
        raise InputError(path, value="no list of runs with their minutes", allowed=_WRITTEN) from error
    return list(earlier)


def _read_json(path: Path) -> Any:
    """Content of a file of a cell's folder; None where there is none; raises InputError where it cannot be read."""
    return parse_json(read_text(path, MOST_JSON), path, not_finite=no_infinite(path)) if path.exists() else None


def _write_json(path: Path, content: Any) -> None:
    """Write a file of a cell's folder, whole or not at all; the folder is made if need be.

    Numbers that are not finite become null.
    """
    content = parse_json(json.dumps(content), path, not_finite=lambda digits: None)
    with replacing(prepare_folder(path.parent) / path.name) as temporary:
        temporary.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def _machine() -> str:
    """Architecture, number of cores, and the GPU, where torch sees one."""
    gpu = f", {torch.cuda.get_device_name()}" if torch.cuda.is_available() else ""
    return f"{platform.machine()}, {os.cpu_count()} cores{gpu}"


def settings_of(cell: Any) -> Any:
    """Return settings of a cell and of those that it is made from, as JSON has them."""
    if is_dataclass(cell):
        told = {one.name: settings_of(getattr(cell, one.name)) for one in fields(cell)}
        return {"kind": type(cell).__name__, **told}
    if isinstance(cell, tuple):
        return [settings_of(one) for one in cell]
    return cell


def _other_setting(cell: Any, settings: Any, name: str = "") -> str:
    """First setting of a cell that differs from those that `settings_of` told, in words; "" where they are the same.

    A field that they lack counts as its default, so that a setting that is added leaves what was made before valid.
    """
    if not is_dataclass(cell):
        told = settings_of(cell)
        if isinstance(cell, tuple) and isinstance(settings, list) and len(cell) == len(settings):
            pairs = enumerate(zip(cell, settings, strict=True))
            return next((other for k, (one, old) in pairs if (other := _other_setting(one, old, f"{name}[{k}]"))), "")
        return "" if told == settings else f"{name}: {settings}, and not {told}"
    known = {one.name: one.default for one in fields(cell)}
    if not isinstance(settings, dict) or settings.get("kind") != type(cell).__name__:
        return f"{name or 'cell'}: another kind than {type(cell).__name__}"
    if more := sorted(settings.keys() - known.keys() - {"kind"}):
        return f"{more[0]}: unknown"
    for field, default in known.items():
        inner, value = f"{name}.{field}" if name else field, getattr(cell, field)
        if field not in settings:
            other = "" if value == default else f"{inner}: none, and not {settings_of(value)}"
        else:
            other = _other_setting(value, settings[field], inner)
        if other:
            return other
    return ""


def empty_folder(path: Path) -> Path:
    """Return a folder that was emptied of what a run left that was killed."""
    shutil.rmtree(path, ignore_errors=True)
    return prepare_folder(path)


def in_order(cells: Iterable[Cell]) -> list[list[Cell]]:
    """All cells that are needed, in waves: those of a wave need none but those of the waves before."""
    depths: dict[Cell, int] = {}

    def depth(cell: Cell) -> int:
        if cell not in depths:
            depths[cell] = 1 + max((depth(one) for one in cell.needs), default=-1)
        return depths[cell]

    for cell in cells:
        depth(cell)
    return [[cell for cell, at in depths.items() if at == k] for k in range(1 + max(depths.values(), default=-1))]


@cache
def commit() -> str:
    """Commit that this package was of when it was asked first, with "+" where files differ from it; "" for none."""
    here = Path(__file__).resolve()

    def git(*arguments: str) -> str:
        command = ["git", *arguments]
        return subprocess.run(command, cwd=here.parent, capture_output=True, text=True, check=True).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", here.name)  # or it is installed within the folder of another repository
        return git("rev-parse", "HEAD")[:12] + ("+" if git("status", "--porcelain") else "")
    except (OSError, subprocess.CalledProcessError):
        return ""
