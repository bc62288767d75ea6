"""Cells of an experiment: each is made once, in a folder of its own, and is not made again."""

import json
import os
import platform
import shutil
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Protocol

import torch

from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.provenance import timestamp, versions

DONE_FILE, RUNS_FILE = "done.json", "runs.json"
_PERIOD = 30.0  # s, between two notes of a run
Say = Callable[[str], None]
"""Called with a line on the progress of a cell."""


class Cell(Protocol):
    """Something that is made once; a frozen dataclass whose fields are its settings, plain data or other cells."""

    @property
    def key(self) -> str:
        """Path of its folder from the root of the experiment."""

    @property
    def needs(self) -> "tuple[Cell, ...]":
        """Cells that have to be made before."""

    @property
    def hours(self) -> float:
        """Estimate of the time that it takes, h of one core."""

    def make(self, root: Path, say: Say) -> Mapping[str, Any]:
        """Makes it in `root / key`, where a run that was killed may have left what it had.

        Args:
            root: Folder of the experiment, with the cells that it needs.
            say: Called with lines on the progress.

        Returns:
            Result as plain data, which tables read.

        Raises:
            PinwmError: An input was refused, or a file cannot be written.
        """


@dataclass(frozen=True)
class CellStore:
    """Results of cells under a folder: what is there is not made again. It serves as a `Store` of an `Executor`.

    Attributes:
        root: Folder of the experiment.
    """

    root: Path

    def read(self, cell: Cell) -> dict[str, Any] | None:
        """Result of a cell with its provenance; None where it is not made yet.

        Raises:
            InputError: The folder holds a cell of other settings, or its file cannot be read.
        """
        path = self.root / cell.key / DONE_FILE
        done: dict[str, Any] | None = _read_json(path)
        if done is not None and not _is_of(cell, done.get("settings")):
            raise InputError(path, value="a cell of other settings", allowed="another folder, or to remove this one")
        return done

    def write(self, cell: Cell, result: Mapping[str, Any]) -> None:
        """Keeps the result of a cell, which is so made."""
        _write_json(self.root / cell.key / DONE_FILE, result)


def made(cell: Cell, root: Path, say: Say) -> dict[str, Any]:
    """Makes a cell, and tells with its result how, where and in what time, all runs together.

    A run notes itself in the cell's folder every half a minute, when it says something, so that one that was killed
    counts. Where there were several, the provenance lists them as `runs`.

    Raises:
        PinwmError: See `Cell.make`.
    """
    path = root / cell.key / RUNS_FILE
    begun, cpu, here = time.monotonic(), time.process_time(), {"commit": commit(), "machine": _machine()}
    earlier, noted = _read_json(path) or [], begun

    def runs() -> list[dict[str, Any]]:
        minutes, cpu_minutes = (time.monotonic() - begun) / 60.0, (time.process_time() - cpu) / 60.0
        spent = {"minutes": round(minutes, 2), "cpu_minutes": round(cpu_minutes, 2)}
        return [*earlier, {"time": timestamp(), **spent, **here}]

    def told(line: str) -> None:
        nonlocal noted
        say(line)
        if time.monotonic() - noted > _PERIOD:
            noted = time.monotonic()
            _write_json(path, runs())

    result, found = dict(cell.make(root, told)), runs()
    path.unlink(missing_ok=True)
    total = {name: round(sum(run[name] for run in found), 2) for name in ("minutes", "cpu_minutes")}
    several = {"runs": found} if earlier else {}
    provenance = {**found[-1], **total, "versions": versions(), **several}
    return {"settings": settings_of(cell), "result": result, "provenance": provenance}


def _read_json(path: Path) -> Any:
    """Content of a file of a cell's folder; None where there is none; raises InputError where it cannot be read."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise InputError(path, value=error, allowed="a file that `pinwm reproduce` wrote") from error


def _write_json(path: Path, content: Any) -> None:
    """Writes a file of a cell's folder, whole or not at all; the folder is made if need be."""
    with replacing(prepare_folder(path.parent) / path.name) as temporary:
        temporary.write_text(json.dumps(content, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def _machine() -> str:
    """Processor, its cores, and the GPU, where torch sees one."""
    gpu = f", {torch.cuda.get_device_name()}" if torch.cuda.is_available() else ""
    return f"{platform.machine()}, {os.cpu_count()} cores{gpu}"


def settings_of(cell: Any) -> Any:
    """Settings of a cell and of those that it is made from, as JSON has them."""
    if is_dataclass(cell):
        told = {one.name: settings_of(getattr(cell, one.name)) for one in fields(cell)}
        return {"kind": type(cell).__name__, **told}
    if isinstance(cell, tuple):
        return [settings_of(one) for one in cell]
    return cell


def _is_of(cell: Any, settings: Any) -> bool:
    """Flag: settings, as `settings_of` told them, are those of a cell.

    A field that they lack counts as its default, so that a setting that is added leaves what was made before valid.
    """
    if is_dataclass(cell):
        known = {one.name: one.default for one in fields(cell)}
        if not isinstance(settings, dict) or settings.get("kind") != type(cell).__name__:
            return False
        told = settings.keys() - {"kind"}
        return told <= known.keys() and all(
            _is_of(getattr(cell, name), settings[name]) if name in told else getattr(cell, name) == default
            for name, default in known.items()
        )
    if isinstance(cell, tuple):
        if not isinstance(settings, list) or len(settings) != len(cell):
            return False
        return all(_is_of(one, told) for one, told in zip(cell, settings, strict=True))
    return bool(cell == settings)


def empty_folder(path: Path) -> Path:
    """A folder that was emptied of what a run left that was killed."""
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


def commit() -> str:
    """Commit that this package is of, with "+" after it where files differ from it; "" outside of a repository."""
    here = Path(__file__).resolve().parent
    try:
        head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=True)
        changed = subprocess.run(["git", "status", "--porcelain"], cwd=here, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return head.stdout.strip()[:12] + ("+" if changed.stdout.strip() else "")
