# SPDX-License-Identifier: MIT
"""Output of the figures: to the screen, into results.json and into the tables of README.md."""

import argparse
import datetime
import importlib.metadata
import json
import os
import platform
import subprocess
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.timing import CompetingLoad

_FOLDER = Path(__file__).resolve().parent
RESULTS = _FOLDER / "results.json"
README = _FOLDER / "README.md"
_PACKAGES = ("numpy", "numba", "torch", "onnxruntime", "drake", "mujoco", "pybullet")


def run(
    name: str,
    description: str,
    measure: Callable[[argparse.Namespace], dict],
    table: Callable[[dict], str],
    *,
    rounds: int | None = None,
    options: Mapping[str, dict[str, Any]] | None = None,
    plot: Callable[[dict], None] | None = None,
) -> None:
    """Run a benchmark as a command: measure, print its table and, with `--write`, store its figures.

    Args:
        name: Name of the benchmark: its key in results.json and its block in README.md.
        description: Description for `--help`.
        measure: Gives the figures, ready for JSON, for the options of the command line.
        table: Gives the same in Markdown.
        rounds: Default of the option `--rounds`; None for a benchmark without one.
        options: Further options and their arguments of `add_argument`.
        plot: Draws the figures where they are stored.

    Raises:
        ValueError: README.md lacks the markers of this block.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--write", action="store_true", help="update benchmarks/results.json and README.md")
    given_rounds = {} if rounds is None else {"--rounds": {"type": int, "default": rounds}}
    for option, settings in (given_rounds | dict(options or {})).items():
        parser.add_argument(option, **settings)
    given = parser.parse_args()
    with CompetingLoad() as load:
        measured = measure(given)
    data = ({} if rounds is None else {"rounds": given.rounds}) | {"load": load.percent, **measured}
    if not given.write:
        print(table(data), flush=True)
        return
    if plot is not None:
        plot(data)
    stored = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    command, date, where = f"python -m benchmarks.{name}", datetime.date.today().isoformat(), machine()
    stored[name] = {"command": command, "date": date, "machine": where, **data}
    RESULTS.write_text(json.dumps(stored, indent=1) + "\n")
    write_block(README, name, table(data), command)


def _cpu_model() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _commit() -> str:
    """Short hash of the measured commit, "+" when the tree differs from it; "unknown" outside git."""
    try:
        command = ["git", "-C", str(_FOLDER), "describe", "--always", "--dirty=+", "--exclude=*"]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def machine() -> dict[str, str]:
    """Processor, cores, system and versions."""
    versions = []
    for package in _PACKAGES:
        try:
            versions.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            versions.append(f"{package} not installed")
    # A virtual machine's model name can hide the generation; family and model number tell it.
    return {
        "processor": f"{_cpu_model()}, {os.cpu_count()} cores",
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "versions": ", ".join(versions),
        "commit": _commit(),
    }


def with_block(text: str, name: str, body: str) -> str:
    """Text of a page whose block, between its markers, is replaced.

    Raises:
        ValueError: The page lacks the markers of this block.
    """
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    before, found, rest = text.partition(begin)
    _, found_end, after = rest.partition(end)
    if not (found and found_end):
        raise ValueError(f"the markers '{begin}' and '{end}' are missing")
    return f"{before}{begin}\n{body}\n{end}{after}"


def write_block(page: Path, name: str, table: str, command: str) -> None:
    """Print a table, and put it between its markers on a page, with command, date, commit and machine.

    Raises:
        ValueError: The page lacks the markers of this block.
    """
    print(table, flush=True)
    where = machine()
    note = (
        f"`{command}`, {datetime.date.today().isoformat()}, commit {where['commit']}, on {where['processor']} "
        f"({where['system']}; {where['versions']})."
    )
    page.write_text(with_block(page.read_text(), name, f"{table}\n\n{note}"))


def write_json(path: Path | None, **figures: object) -> None:
    """Write figures, with the machine, into a file; nothing without one."""
    if path is not None:
        path.write_text(json.dumps({"machine": machine(), **figures}, indent=1) + "\n")


def markdown(header: str, rows: Iterable[Iterable[object]]) -> list[str]:
    """Lines of a table in Markdown.

    Args:
        header: Its columns, with " | " between them.
        rows: Cells of each row.
    """
    dashes = "| --- " * (header.count(" | ") + 1) + "|"
    return [f"| {header} |", dashes, *(f"| {' | '.join(map(str, row))} |" for row in rows)]


def spread(summary: dict[str, float], digits: int = 1) -> str:
    """Return a median with its quartiles, e.g. "12.2 (12.1 to 12.3)"."""
    return f"{summary['median']:.{digits}f} ({summary['q1']:.{digits}f} to {summary['q3']:.{digits}f})"


def verdict(value: float, bar: float, at_most: bool = True) -> str:
    """Verdict on a figure against its bar, e.g. "2.31, bar at most 2.5: met"."""
    met = value <= bar if at_most else value >= bar
    side = "at most" if at_most else "at least"
    return f"{value:.2f}, bar {side} {bar:g}: {'met' if met else 'MISSED'}"
