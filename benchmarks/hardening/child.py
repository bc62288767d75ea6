# SPDX-License-Identifier: MIT
"""A process that reads damaged samples, and tells of each on a line of JSON; see `readers.py`.

    python -m benchmarks.hardening.child FOLDER SEED READER FIRST LAST [READER FIRST LAST ...]

Whatever is opened for writing outside of the folder, started or connected to is noted by an audit hook.
"""

import contextlib
import json
import os
import re
import resource
import shutil
import sys
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hardening.mutations import mutate
from benchmarks.hardening.samples import READERS, mend
from benchmarks.hardening.values import summary
from pinwm_drake.errors import PinwmError
from pinwm_drake.files import appearing

MOST_MEMORY, LONGEST_LINE = 2 * 2**30, 300
LONGEST = 10.0  # s of the CPU
_SEALED = 0.3  # share of the damaged files that a hash protects, whose hash is not made anew
_ADDRESSES = 16 * 2**30  # bytes; libraries map far more than they use
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_STARTS = ("os.system", "subprocess.Popen", "os.exec", "os.posix_spawn", "socket.connect", "socket.bind")
_PLACES = ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.symlink", "os.link", "shutil.rmtree")


class Watch:
    """Notes of what reading did besides reading."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.on, self.notes = str(folder.resolve()), False, list[str]()
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event == "open":
            path, _, flags = arguments
            if isinstance(path, (str, bytes)) and flags & _WRITING:
                self._place(event, path)
        elif event in _STARTS:
            self.notes.append(f"{event} {arguments!r}"[:200])
        elif event in _PLACES:
            for path in arguments[:2]:
                if isinstance(path, (str, bytes)):
                    self._place(event, path)

    def _place(self, event: str, path: str | bytes) -> None:
        whole = os.path.abspath(os.fsdecode(path))
        if not whole.startswith(self.folder) and whole != os.devnull:
            self.notes.append(f"{event} {whole}"[:200])

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Context in which notes are taken."""
        self.on = True
        try:
            yield
        finally:
            self.on = False


def peak() -> int:
    """Largest resident memory since the last call, bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            found = 1024 * int(line.split()[1])
    Path("/proc/self/clear_refs").write_text("5")
    return found


def attack(
    name: str, number: int, seed: int, sample: Path, folder: Path, watch: Watch, right: tuple[str, int] = ("", 0)
) -> dict[str, Any]:
    """Read one damaged sample; what came of it. `right` is the `summary` of the sample."""
    print(json.dumps({"damages": [name, number]}), flush=True)
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(sample, folder)
    reader = READERS[name]
    rng = np.random.default_rng([seed, number, zlib.crc32(name.encode())])
    how = mutate(folder, rng)
    damaged = how.partition(": ")[0]
    sealed = bool(reader.sealed and re.fullmatch(reader.sealed, damaged) and rng.random() < _SEALED)
    sealed = sealed and os.path.lexists(folder / damaged)  # without a checkpoint work begins anew
    if not sealed:
        mend(reader, folder)
    peak()
    watch.notes.clear()
    print(json.dumps({"begins": [name, number], "how": how}), flush=True)
    begun, wrong, outcome = time.process_time(), "", "read"
    with watch.watching():
        try:
            found = reader.read(folder)
        except PinwmError as error:
            outcome, message = "refused", str(error)
            if len(message) > LONGEST_LINE or not message.isprintable():
                wrong = f"message of {len(message)} characters: {message[:400]}"
        except BaseException as error:
            wrong = f"{type(error).__name__}: {error}"[:400]
    memory, seconds = peak(), round(time.process_time() - begun, 3)
    if outcome == "read" and not wrong:
        digest, bad = summary(found)
        if bad > right[1]:
            wrong = f"numbers that are not finite: {bad}"
        elif sealed and digest != right[0]:
            wrong = "other contents than the hash tells"
    if seconds > LONGEST:
        wrong = wrong or f"{seconds} s of the CPU"
    if memory > MOST_MEMORY:
        wrong = wrong or f"memory of {memory >> 20} MB"
    if watch.notes:
        wrong = wrong or "; ".join(watch.notes[:3])
    return {
        "reader": name,
        "done": number,
        "outcome": "wrong" if wrong else outcome,
        "wrong": wrong,
        "how": how,
        "seconds": seconds,
        "memory": memory,
    }


def main() -> None:
    """Do the tasks of the command line."""
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESSES, _ADDRESSES))
    out, seed = Path(sys.argv[1]), int(sys.argv[2])
    watch = Watch(out)
    tasks = sys.argv[3:]
    for name, first, last in zip(tasks[::3], tasks[1::3], tasks[2::3], strict=True):
        sample = out / "samples" / name
        print(json.dumps({"prepares": name}), flush=True)
        if not sample.exists():
            with appearing(sample) as temporary:
                READERS[name].make(temporary)
        shutil.rmtree(out / "work", ignore_errors=True)
        right = summary(READERS[name].read(shutil.copytree(sample, out / "work")))  # and kernels are compiled
        for number in range(int(first), int(last)):
            print(json.dumps(attack(name, number, seed, sample, out / "work", watch, right)), flush=True)
        shutil.rmtree(out / "work", ignore_errors=True)


if __name__ == "__main__":
    main()
