# SPDX-License-Identifier: MIT
"""Command line of the gallery: captures, twins, films and pages of six objects; what is there stays.

python -m benchmarks.gallery [--only NAME ...] [--work FOLDER] [--pages]
"""

import argparse
import os
import shlex
import subprocess
import sys
from pathlib import Path

from benchmarks.gallery.captures import EXHIBITS, Exhibit
from benchmarks.gallery.page import write_pages
from benchmarks.gallery.record import record

_ROOT = Path(__file__).resolve().parents[2]
_RESULTS = _ROOT / "docs/results/gallery"
# The budget of `pinwm demo`: images of 240 px need fewer steps and surfels than the defaults.
_ALIGN, _IDENTIFY = "--iterations 1500 --max-surfels 2500 --threads 1", "--threads 1"


def main() -> None:
    """Run the command."""
    names = [exhibit.name for exhibit in EXHIBITS]
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gallery", description=__doc__.split(":")[0])
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="NAME", help=", ".join(names))
    parser.add_argument("--work", type=Path, default=Path("out/gallery"), help="folder of captures and twins")
    parser.add_argument("--pages", action="store_true", help="write the pages anew from the stored results")
    arguments = parser.parse_args()
    for exhibit in EXHIBITS:
        if exhibit.name in arguments.only and not arguments.pages:
            _make(exhibit, arguments.work / exhibit.name)
    write_pages(_RESULTS)


def _make(exhibit: Exhibit, work: Path) -> None:
    work.mkdir(parents=True, exist_ok=True)
    capture, twin = work / "capture", work / "twin"
    steps = [
        (capture, f"capture simulate {capture} {exhibit.capture_command}"),
        (twin / "align.json", f"align {capture} {twin} {_ALIGN} --resume"),
        (twin / "twin.yaml", f"identify {capture} {twin} {_IDENTIFY} --resume"),
        (twin / "report.html", f"report {twin}"),
    ]
    told = [f"pinwm {command.removesuffix(' --resume')}" for _, command in steps]
    if exhibit.specification:
        told[0] = f"# {capture}: two pushes of {exhibit.specification} of benchmarks.next_push, by this script"
    for number, (made, command) in enumerate(steps):
        if made.exists():
            continue
        print(told[number], flush=True)
        if number == 0 and exhibit.specification:
            exhibit.write_capture(capture)
        else:
            _run(command)
    record(exhibit, work, _RESULTS, told)


def _run(command: str) -> None:
    call = [sys.executable, "-c", "from pinwm_drake.cli import main; main()", *shlex.split(command)]
    subprocess.run(call, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"})


if __name__ == "__main__":
    main()
