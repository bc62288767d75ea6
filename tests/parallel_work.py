# SPDX-License-Identifier: MIT
"""Work for the tests of `pinwm_drake.parallel`, which its workers import."""

import json
import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock

from pinwm_drake.errors import InputError, SolverError
from pinwm_drake.files import replacing
from pinwm_drake.parallel import Executor
from pinwm_drake.threads import available


@dataclass(frozen=True)
class Folder:
    """A store of numbers."""

    path: Path

    def read(self, item: int) -> float | None:
        path = self.path / f"{item}.json"
        return json.loads(path.read_text()) if path.exists() else None

    def write(self, item: int, result: float) -> None:
        with replacing(self.path / f"{item}.json") as path:
            path.write_text(json.dumps(result))

    def holding(self, item: int) -> FileLock:
        return FileLock(self.path / f"{item}.lock")

    def items(self) -> list[int]:
        return sorted(int(path.stem) for path in self.path.glob("[0-9]*.json"))


def half(item: int) -> float:
    return item / 2


def logged(folder: Path, item: int) -> float:
    """Leaves a line for each time that it is called."""
    with (folder / "log").open("a") as file:
        file.write(f"{item}\n")
    return item / 2


def sum_of_needed(folder: Folder, item: int) -> float:
    """One more than the results of the items that `smaller` names, which are in the folder."""
    found = [folder.read(one) for one in smaller(item)]
    return 1.0 + sum(one for one in found if one is not None) if None not in found else float("nan")


def smaller(item: int) -> list[int]:
    return [one for one in (item - 1, item - 2) if one >= 0]


def pid(item: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def gate(folder: Path, item: int) -> float:
    """Items of 2 and more begin, and wait for a file that lets them go on; each leaves its process."""
    (folder / f"begun.{item}.{os.getpid()}").touch()
    while item >= 2 and not (folder / "go").exists():
        time.sleep(0.02)
    return item / 2


def fail(kind: str, item: int) -> float:
    if item != 1:
        return 0.0
    if kind == "input":
        raise InputError("a.csv", row=3, value=ValueError("x"), allowed="finite")
    if kind == "solver":
        raise SolverError("none", worlds=(1, 2))
    raise ValueError("no error of the family")


def threads(item: int) -> tuple[int, int, int]:
    import numba
    import torch

    return torch.get_num_threads(), numba.get_num_threads(), available()


def torch_threads(item: int) -> int:
    import torch

    return torch.get_num_threads()


def main() -> None:
    """A driver that is to be killed: `python -m tests.parallel_work EXECUTOR FOLDER`."""
    from functools import partial

    # A background script's children ignore it, as the tests may be.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    folder = Path(sys.argv[2])
    executor = Executor(sys.argv[1], workers=2)
    try:
        executor.map(partial(gate, folder), range(6), store=Folder(folder))
    except KeyboardInterrupt:
        (folder / "interrupted").touch()


if __name__ == "__main__":
    main()
