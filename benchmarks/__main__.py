# SPDX-License-Identifier: MIT
"""Runs every benchmark, each in a process of its own, and rewrites the tables of benchmarks/README.md."""

import argparse
import subprocess
import sys
import time
from pathlib import Path

NAMES = (
    "step",
    "scaling",
    "worlds",
    "memory",
    "render",
    "station",
    "environment",
    "flip",
    "policy",
)
LONG = ("hydroelastic",)  # a quarter of an hour or more: by name only


def main() -> None:
    """Run the named benchmarks, by default all that are not long; exits with 1 when one fails."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    words = f"any of {', '.join(NAMES + LONG)}; default: all but {', '.join(LONG)}"
    parser.add_argument("names", nargs="*", metavar="name", help=words)
    parser.add_argument("--dry", action="store_true", help="print only; change no file")
    given = parser.parse_args()
    unknown = [name for name in given.names if name not in NAMES + LONG]
    if unknown:
        parser.error(f"unknown: {', '.join(unknown)}; allowed: {', '.join(NAMES + LONG)}")
    failed = []
    for name in given.names or NAMES:
        print(f"## {name}", flush=True)
        start = time.perf_counter()
        command = [sys.executable, "-m", f"benchmarks.{name}", *([] if given.dry else ["--write"])]
        if subprocess.run(command, cwd=Path(__file__).resolve().parent.parent, check=False).returncode:
            failed.append(name)
        print(f"({time.perf_counter() - start:.0f} s)\n", flush=True)
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
