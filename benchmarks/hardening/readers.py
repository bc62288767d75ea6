# SPDX-License-Identifier: MIT
"""Damaged files for every reader: only errors of the package, one line, 10 s, 2 GB, nothing written elsewhere.

Children read batches of damaged samples. A child that ends or makes no progress is a violation of the file at hand; the
next one goes on after it. Times are those of the CPU; a child that sleeps and uses none is given a minute.
"""

import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import psutil

from pinwm_drake.files import replacing

ROOT = Path(__file__).resolve().parents[2]
LONGEST, LONGEST_SLEEP = 10.0, 60.0  # s of the CPU, and of sleep without any
STARTUP = 1200.0  # s of the CPU, in which a child imports, makes samples, damages files and compiles
_BATCH = 4000  # files that a child reads before another one takes its place
_KEEP_EVERY = 30.0  # s between two writes of the state
_KEPT = 100  # violations that are told in full
CHILD = "benchmarks.hardening.child"
STATE = "readers.json"


def run(out: Path, number: int, seed: int, readers: list[str] | None = None) -> dict[str, Any]:
    """Read `number` damaged files, shared evenly among the readers; see `parts.Part`."""
    names = readers or _names()
    state: dict[str, Any] = {"seed": seed, "readers": {}, "violations": []}
    if (out / STATE).exists():
        state = json.loads((out / STATE).read_text())
        if state["seed"] != seed:
            raise SystemExit(f"{out / STATE}: seed {state['seed']}; allowed: {seed}, or another folder")
    each = -(-number // len(names))
    for name in names:
        state["readers"].setdefault(name, {"done": 0, "refused": 0, "read": 0, "wrong": 0, "seconds": 0.0, "memory": 0})
    while tasks := _tasks(state["readers"], names, each):
        _child(out, seed, tasks, state)
        _keep(out, state)
    return {**state, "number": sum(one["done"] for one in state["readers"].values())}


def table(found: dict[str, Any]) -> str:
    """Counts by reader."""
    head = ("reader", "files", "refused", "read", "wrong", "longest, s of CPU", "most memory, MB")
    rows = []
    for name, one in found["readers"].items():
        counts = [one[key] for key in ("done", "refused", "read", "wrong")]
        rows.append([name, *counts, round(one["seconds"], 1), one["memory"] >> 20])
    total = ["all", *(sum(row[k] for row in rows) for k in range(1, 5)), *(max(row[k] for row in rows) for k in (5, 6))]
    lines = [f"| {' | '.join(head)} |", "| --- " * len(head) + "|"]
    return "\n".join(lines + [f"| {' | '.join(map(str, row))} |" for row in [*rows, total]])


def _names() -> list[str]:
    """Names of the readers, from a process that may import what they need."""
    code = "import json; from benchmarks.hardening.samples import READERS; print(json.dumps(list(READERS)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    names: list[str] = json.loads(done.stdout)
    return names


def _tasks(counts: dict[str, Any], names: list[str], each: int) -> list[str]:
    """Arguments of a child: readers with the numbers of their files, `_BATCH` in all."""
    left, tasks = _BATCH, list[str]()
    for name in names:
        first = counts[name]["done"]
        last = min(each, first + left)
        if last > first:
            tasks += [name, str(first), str(last)]
            left -= last - first
    return tasks


def _child(out: Path, seed: int, tasks: list[str], state: dict[str, Any]) -> None:
    """Run a child to its end, or until it is stuck, and count what it tells."""
    with tempfile.TemporaryDirectory() as home:
        # A folder of its own for all that libraries keep; kernels are those beside the sources.
        places = dict.fromkeys(("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"), home)
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        command = [sys.executable, "-m", CHILD, str(out.absolute()), str(seed), *tasks]
        with (out / "stderr.txt").open("ab") as errors:
            child = subprocess.Popen(
                command,
                cwd=ROOT,
                env={**os.environ, **places, **threads},
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
            )
        lines: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=_listen, args=(child, lines), daemon=True).start()
        now: dict[str, Any] = {"prepares": "the imports"}
        kept = time.monotonic()
        while (line := _next(child, lines, LONGEST if "begins" in now else STARTUP)) is not None:
            now = json.loads(line)
            if "done" in now:
                _count(state, now.pop("reader"), now)
            if time.monotonic() - kept > _KEEP_EVERY:
                _keep(out, state)
                kept = time.monotonic()
        ended = child.poll()
        if ended is None:
            child.kill()
            child.wait()
        if ended != 0:
            words = "no answer in time" if ended is None else f"the process ended with {ended}"
            if "begins" not in now:
                raise SystemExit(f"{now}: {words}, which is the harness's fault; see {out / 'stderr.txt'}")
            name, number = now["begins"]
            told = {"done": number, "outcome": "wrong", "wrong": words, "how": now["how"]}
            _count(state, name, told | {"seconds": LONGEST, "memory": 0})


def _listen(child: subprocess.Popen[str], lines: "queue.Queue[str | None]") -> None:
    assert child.stdout is not None
    for line in child.stdout:
        lines.put(line)
    child.wait()
    lines.put(None)


def _next(child: subprocess.Popen[str], lines: "queue.Queue[str | None]", most: float) -> str | None:
    """Next line of a child; None at its end, and where it is stuck: after `most` s of the CPU, or asleep."""
    begun, slept = _cpu(child), 0.0
    before = begun
    while slept < LONGEST_SLEEP:
        try:
            return lines.get(timeout=1.0)
        except queue.Empty:
            spent = _cpu(child)
            # One that waits for its turn on a busy machine does not sleep.
            slept = slept + 1.0 if spent == before and _asleep(child) else 0.0
            before = spent
            if spent - begun > most:
                return None
    return None


def _asleep(child: subprocess.Popen[str]) -> bool:
    try:
        return psutil.Process(child.pid).status() != psutil.STATUS_RUNNING
    except psutil.Error:
        return True


def _cpu(child: subprocess.Popen[str]) -> float:
    try:
        times = psutil.Process(child.pid).cpu_times()
    except psutil.Error:
        return 0.0
    return float(times.user + times.system)


def _count(state: dict[str, Any], name: str, told: dict[str, Any]) -> None:
    one = state["readers"][name]
    one["done"] = told["done"] + 1
    one[told["outcome"]] += 1
    one["seconds"], one["memory"] = max(one["seconds"], told["seconds"]), max(one["memory"], told["memory"])
    if told["wrong"] and len(state["violations"]) < _KEPT:
        state["violations"].append({"reader": name, "number": told["done"], "how": told["how"], "wrong": told["wrong"]})


def _keep(out: Path, state: dict[str, Any]) -> None:
    with replacing(out / STATE) as temporary:
        temporary.write_text(json.dumps(state, indent=1) + "\n")
