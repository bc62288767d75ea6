# SPDX-License-Identifier: MIT
"""Attacks the package, part by part, and says what it did not stand.

    python -m benchmarks.hardening [PART ...] [--number 1000] [--seed 0] [--out FOLDER] [--write]

The same command goes on where it was interrupted. With `--write` the counts go to docs/results/hardening.json and to
the table of docs/reference/reliability.md. Exits with 1 where something went wrong.
"""

import argparse
import json
import sys
import time
from pathlib import Path

from benchmarks.hardening.parts import PARTS, part
from benchmarks.results import machine, write_block
from pinwm_drake.files import prepare_folder

ROOT = Path(__file__).resolve().parents[2]
RESULTS, PAGE = ROOT / "docs/results/hardening.json", ROOT / "docs/reference/reliability.md"


def main() -> None:
    """Run the parts."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hardening", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="part", help=f"any of {', '.join(PARTS)}; default: all")
    parser.add_argument("--number", type=int, default=1000, help="size of each attack")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("hardening"), help="folder of the state")
    parser.add_argument("--write", action="store_true", help="rewrite the table of docs/reference/reliability.md")
    given = parser.parse_args()
    unknown = [name for name in given.parts if name not in PARTS]
    if unknown:
        parser.error(f"unknown: {', '.join(unknown)}; allowed: {', '.join(PARTS)}")
    wrong = 0
    for name in given.parts or PARTS:
        begun, module = time.monotonic(), part(name)
        found = module.run(prepare_folder(given.out / name), given.number, given.seed)
        table, command = module.table(found), f"python -m benchmarks.hardening {name} --number {given.number}"
        command += f" --seed {given.seed}"
        found |= {"command": command, "seconds": round(time.monotonic() - begun), "machine": machine()}
        for violation in found["violations"]:
            print(f"violation: {json.dumps(violation)}", file=sys.stderr, flush=True)
        wrong += len(found["violations"])
        if given.write:
            stored = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
            RESULTS.write_text(json.dumps(stored | {name: found}, indent=1, sort_keys=True) + "\n")
            write_block(PAGE, f"hardening {name}", table, command)
        else:
            print(table, flush=True)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
