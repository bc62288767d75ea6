# SPDX-License-Identifier: MIT
"""Cells for the tests of clusters, which workers import."""

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path

from pinwm_drake.paper.reproduce.cell import DONE_FILE


@dataclass(frozen=True)
class Gated:
    """A cell that leaves its process; a number, the sum of those that it needs and one."""

    name: str
    waits: bool = False  # for a file that lets it go on
    needs: tuple["Gated", ...] = ()
    hours: float = 0.001

    @property
    def key(self) -> str:
        return f"gated/{self.name}"

    def make(self, root: Path, say) -> dict[str, int]:
        (root / f"begun.{self.name}.{os.getpid()}").touch()
        while self.waits and not (root / "go").exists():
            time.sleep(0.02)
        parts = [json.loads((root / one.key / DONE_FILE).read_text())["result"]["sum"] for one in self.needs]
        return {"sum": 1 + sum(parts), "process": os.getpid()}
