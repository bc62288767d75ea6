"""Output of the figures: to the screen, into results.json and into the tables of README.md."""

import argparse
import datetime
import importlib.metadata
import json
import os
import platform
import re
import subprocess
from pathlib import Path

_FOLDER = Path(__file__).resolve().parent
RESULTS = _FOLDER / "results.json"
README = _FOLDER / "README.md"
_PACKAGES = ("numpy", "numba", "torch", "onnxruntime", "drake", "mujoco", "pybullet")


def arguments(description: str) -> argparse.ArgumentParser:
    """The options that every benchmark has; it may add its own."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--write", action="store_true", help="update benchmarks/results.json and README.md")
    return parser


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


def _replace_block(text: str, name: str, content: str) -> str:
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
    if not pattern.search(text):
        raise ValueError(f"{README}: the markers '{begin}' and '{end}' are missing")
    return pattern.sub(lambda _: f"{begin}\n{content}\n{end}", text)


def publish(name: str, data: dict, table: str, write: bool) -> None:
    """Prints a benchmark's table and, if asked, stores its figures.

    Args:
        name: Name of the benchmark: its key in results.json and its block in README.md.
        data: Figures of the benchmark, ready for JSON.
        table: The same in Markdown.
        write: Whether to update the two files.

    Raises:
        ValueError: README.md lacks the markers of this block.
    """
    print(table, flush=True)
    if not write:
        return
    stored = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    date = datetime.date.today().isoformat()
    stored[name] = {"command": f"python -m benchmarks.{name}", "date": date, "machine": machine(), **data}
    RESULTS.write_text(json.dumps(stored, indent=1) + "\n")
    where = stored[name]["machine"]
    note = (
        f"`python -m benchmarks.{name}`, {date}, commit {where['commit']}, on {where['processor']} "
        f"({where['system']}; {where['versions']})."
    )
    README.write_text(_replace_block(README.read_text(), name, f"{table}\n\n{note}"))


def spread(summary: dict[str, float], digits: int = 1) -> str:
    """A median with its quartiles, e.g. "12.2 (12.1 to 12.3)"."""
    return f"{summary['median']:.{digits}f} ({summary['q1']:.{digits}f} to {summary['q3']:.{digits}f})"


def verdict(value: float, bar: float, at_most: bool = True) -> str:
    """Verdict on a figure against its bar, e.g. "2.31, bar at most 2.5: met"."""
    met = value <= bar if at_most else value >= bar
    side = "at most" if at_most else "at least"
    return f"{value:.2f}, bar {side} {bar:g}: {'met' if met else 'MISSED'}"
