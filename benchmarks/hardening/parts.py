# SPDX-License-Identifier: MIT
"""Parts of the hardening: a module each, with `run` and `table`."""

import importlib
from pathlib import Path
from typing import Any, Protocol

# Modules by the names of their parts. Each may be run by itself, and is imported only then.
PARTS = {
    "readers": "benchmarks.hardening.readers",
    "messages": "benchmarks.hardening.messages",
    "kills": "benchmarks.hardening.kills",
    "endurance": "benchmarks.hardening.endurance",
    "agreement": "benchmarks.hardening.agreement",
}


class Part(Protocol):
    """Module of a part."""

    def run(self, out: Path, number: int, seed: int) -> dict[str, Any]:
        """Attack, or go on with an attack that was interrupted.

        Args:
            out: Folder of the state, which exists; a second call goes on with what the first one left there.
            number: Size of the attack, such as the number of mutated files.
            seed: Seed of all that is drawn.

        Returns:
            Counts as plain data, with a list `violations` of what went wrong.
        """

    def table(self, found: dict[str, Any]) -> str:
        """Counts as a table in Markdown."""


def part(name: str) -> Part:
    """Module of a part."""
    return importlib.import_module(PARTS[name])  # type: ignore[return-value]
