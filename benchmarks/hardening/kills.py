# SPDX-License-Identifier: MIT
"""SIGKILL at random moments of small runs: the same results after they go on, and nothing left over.

Every command runs whole once, for a reference. Then a run is killed at a random moment, again after it went on in one
of three cases, and goes on to its end. Its files are compared with those of the reference, without times and versions.
Each run is a fork of a process that has imported and compiled everything, so that moments are those of the work, and
not of Python's imports. The folder for temporary files has to be empty after the next run, too.
"""

import atexit
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tests.cli.evaluations import SCENARIO

Generator = np.random.Generator
_TIMES = (
    "second",
    "minute",
    "created",
    "time",
    "provenance",
    "versions",
    "cpu",
    "commit",
    "machine",
    "command",
    "resume",
)
_SKIPPED = (".html", ".mp4", ".config.yaml", "progress.png", ".txt", ".md", "checkpoint.npz", "training.png")
_SKIPPED_FOLDERS = ("tensorboard",)


@dataclass(frozen=True)
class Command:
    """A small run of a command.

    Attributes:
        arguments: Arguments of `pinwm`; OUT stands for the folder of results.
        resume: Arguments that let it go on.
        prepare: Writes into a new folder of results what the run begins with.
        keeps: Flag: a run refuses to write over results, also over those that a killed run has finished.
    """

    arguments: tuple[str, ...]
    resume: tuple[str, ...] = ("--resume",)
    prepare: Callable[[Path], None] = lambda out: None
    keeps: bool = False


def commands(inputs: Path) -> dict[str, Command]:
    """Commands that are killed; captures and scene are written to `inputs` once."""
    from tests.capture.cube import write_capture as write_views
    from tests.identification.samples import write_appearance, write_capture

    scene = inputs / "small.scenario.yaml"
    if not scene.exists():
        shutil.rmtree(inputs)
        inputs.mkdir()
        write_views(inputs / "views")
        write_capture(inputs / "push")
        scene.write_text(SCENARIO)
    small = ("--max-surfels", "120", "--sh-degree", "1", "--threads", "1", "--iterations", "400")
    quick = (
        "--starts",
        "1",
        "--support",
        "patch",
        "--threads",
        "1",
        "--free",
        "friction_floor",
        "--time-step",
        "0.005",
    )
    tiny = ("--worlds", "4", "--image-size", "32", "--threads", "1", "--episodes", "4")
    few = ("--engine", "twin", "--episodes", "4", "--max-steps", "4", "--workers", "1", "--scene", str(scene))
    table = ("--task", "push", "--methods", "random-actions", "--episodes", "1", "--quick", "--workers", "1")
    return {
        "align": Command(("align", str(inputs / "views"), "OUT", *small)),
        "identify": Command(("identify", str(inputs / "push"), "OUT", *quick), prepare=write_appearance),
        "train": Command(
            ("train", "push_t", "-o", "OUT", "--method", "state", "--steps", "512", "--round-steps", "256", *tiny)
        ),
        "evaluate": Command(("evaluate", "random", "-o", "OUT", "--seed", "5", *few)),
        "reproduce": Command(("reproduce", "policies", "-o", "OUT", *table), resume=()),
        "simulate": Command(
            ("simulate", str(scene), "--engine", "twin", "-o", "OUT/episode", "--duration", "1", "--seed", "3"),
            resume=(),
            keeps=True,
        ),
    }


def begin(arguments: tuple[str, ...], log: Path) -> int:
    """Start `pinwm` in a fork of this process; its number."""
    child = os.fork()
    if child:
        return child
    code = 70
    try:
        os.setsid()
        file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(file, 1)
        os.dup2(file, 2)
        sys.stdout, sys.stderr = (open(number, "w", closefd=False) for number in (1, 2))  # noqa: SIM115
        from pinwm_drake.cli import main

        sys.argv = ["pinwm", *arguments]
        main()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    finally:
        atexit._run_exitfuncs()  # which `_exit` leaves out
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def finish(child: int) -> int:
    """Wait for a fork; its exit code, negative after a signal."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def kill(child: int, after: float) -> bool:
    """Kill a fork and what it started after a time, s; flag: it was still at work."""
    end = time.monotonic() + after
    while time.monotonic() < end:
        if os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
            break
        time.sleep(0.005)
    try:
        os.killpg(child, signal.SIGKILL)
    except ProcessLookupError:  # it has not come to `setsid`
        os.kill(child, signal.SIGKILL)
    return finish(child) == -signal.SIGKILL


def contents(out: Path) -> dict[str, Any]:
    """What a run has written, without times: comparable values by the names of files."""
    found = {}
    for path in sorted(out.rglob("*")):
        name = str(path.relative_to(out))
        if path.is_dir() or name.endswith(_SKIPPED) or any(part in _SKIPPED_FOLDERS for part in path.parts):
            continue
        found[name] = _content(path)
    return found


def _content(path: Path) -> Any:
    if path.suffix in (".json", ".yaml"):
        return _timeless(yaml.safe_load(path.read_text()))
    if path.suffix == ".csv":
        return [_timeless(row) for row in csv.DictReader(path.open())]
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return {name: _array(arrays[name]) for name in arrays.files if not _timed(name)}
    return path.read_bytes().hex()


def _array(value: np.ndarray) -> Any:
    if value.dtype.kind == "U":
        try:
            return _timeless(json.loads(str(value)))
        except ValueError:
            return str(value)
    return [str(value.dtype), list(value.shape), value.tobytes().hex()]


def _timed(name: str) -> bool:
    # A checkpoint's hash is that of its arrays, with times among them.
    return name == "sha256 of the arrays" or any(word in name.lower() for word in _TIMES)


def _timeless(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _timeless(one) for key, one in value.items() if not _timed(str(key))}
    return [_timeless(one) for one in value] if isinstance(value, list) else value


def differences(found: dict[str, Any], wanted: dict[str, Any]) -> list[str]:
    """Names of the files that differ, or that are there only once."""
    return sorted(name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name))


def leftovers(*folders: Path) -> list[str]:
    """Hidden files and folders of runs."""
    return sorted(
        str(path) for folder in folders for path in folder.rglob("*") if path.name.startswith((".", "pinwm~"))
    )


def try_once(name: str, command: Command, out: Path, seconds: float, rng: Generator) -> dict[str, Any]:
    """Kill a run, let it go on, and compare; what came of it."""
    folder, temporary = out / "work", Path(os.environ["TMPDIR"])
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    command.prepare(folder)
    log, kills, at = out / "log.txt", 0, []
    log.unlink(missing_ok=True)
    while True:
        again = command.resume if at else ()
        child = begin((*(one.replace("OUT", str(folder)) for one in command.arguments), *again), log)
        after = round(float(rng.uniform(0.0, seconds)), 3)
        if at and rng.random() < 2 / 3:
            code = finish(child)
            break
        at.append(after)
        if not kill(child, after):  # it was quicker
            code = 0  # or its results would be others
            break
        kills += 1
    wrong = ""
    left = leftovers(folder, temporary)
    differing = differences(contents(folder), json.loads((out / f"{name}.json").read_text())["contents"])
    if code != 0 and (differing or not command.keeps):
        wrong = f"exit code {code}: {' '.join(log.read_text(errors='replace').split())[-300:]}"
    elif differing:
        wrong = f"other results: {', '.join(differing)}"[:300]
    elif left:
        wrong = f"left over: {', '.join(left)}"[:300]
    return {"kills": kills, "at": at, "wrong": wrong}


def run(out: Path, number: int, seed: int, names: tuple[str, ...] = ()) -> dict[str, Any]:
    """Kill `number` runs of all commands together; `names` are some of the commands.

    See `parts.Part.run`.
    """
    arguments = [sys.executable, "-m", "benchmarks.hardening.kills", str(out), str(number), str(seed), *names]
    subprocess.run(arguments, check=True, env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})
    return summary(out, seed)


def summary(out: Path, seed: int) -> dict[str, Any]:
    """Counts of all runs that are noted."""
    rows = [json.loads(line) for line in (out / f"tries-{seed}.jsonl").read_text().splitlines()]
    counts: dict[str, Any] = {}
    for row in rows:
        one = counts.setdefault(row["command"], {"runs": 0, "kills": 0, "wrong": 0})
        one["runs"] += 1
        one["kills"] += row["kills"]
        one["wrong"] += bool(row["wrong"])
    return {
        "number": sum(one["kills"] for one in counts.values()),
        "commands": counts,
        "violations": [row for row in rows if row["wrong"]],
    }


def table(found: dict[str, Any]) -> str:
    """Counts as a table in Markdown."""
    rows = ["| command | runs | kills | other results, or leftovers |", "| --- | --- | --- | --- |"]
    for name, one in sorted(found["commands"].items()):
        rows.append(f"| {name} | {one['runs']} | {one['kills']} | {one['wrong']} |")
    runs, wrong = (sum(one[key] for one in found["commands"].values()) for key in ("runs", "wrong"))
    return "\n".join([*rows, f"| all | {runs} | {found['number']} | {wrong} |"])


def main() -> None:
    """Make references and kills up to a number; called by `run` in a process of its own."""
    out, number, seed = Path(sys.argv[1]).resolve(), int(sys.argv[2]), int(sys.argv[3])
    temporary = out / "tmp"
    temporary.mkdir(exist_ok=True)
    os.environ["TMPDIR"] = str(temporary)
    (out / "inputs").mkdir(exist_ok=True)
    every = commands(out / "inputs")
    chosen = {name: command for name, command in every.items() if not sys.argv[4:] or name in sys.argv[4:]}
    notes = out / f"tries-{seed}.jsonl"
    tries = [json.loads(line) for line in notes.read_text().splitlines()] if notes.exists() else []
    done, killed = len(tries), sum(row["kills"] for row in tries)
    import pinwm_drake.cli.app  # noqa: F401

    for name, command in chosen.items() if killed < number else ():
        _reference(name, command, out)
    seconds = {name: json.loads((out / f"{name}.json").read_text())["seconds"] for name in chosen}
    with notes.open("a") as file:
        while killed < number:
            name = list(chosen)[done % len(chosen)]
            rng = np.random.default_rng([seed, done])
            found = try_once(name, chosen[name], out, seconds[name], rng)
            file.write(json.dumps({"command": name, **found}) + "\n")
            file.flush()
            done, killed = done + 1, killed + found["kills"]


def _reference(name: str, command: Command, out: Path) -> None:
    """Run a command whole: in this process to warm it up, then in a fork, which counts."""
    from pinwm_drake.cli import main as pinwm

    stored = out / f"{name}.json"
    for forked in (False, True):
        folder = out / "work"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        command.prepare(folder)
        arguments = tuple(one.replace("OUT", str(folder)) for one in command.arguments)
        begun = time.monotonic()
        if forked:
            code = finish(begin(arguments, out / "log.txt"))
            if code != 0:
                raise SystemExit(f"{name}: exit code {code}; see {out / 'log.txt'}")
        else:
            sys.argv = ["pinwm", *arguments]
            try:
                pinwm()
            except SystemExit as end:
                if end.code not in (0, None):
                    raise
        seconds, found = time.monotonic() - begun, contents(folder)
        if forked and not stored.exists():
            stored.write_text(json.dumps({"seconds": seconds, "contents": found}))


if __name__ == "__main__":
    main()
