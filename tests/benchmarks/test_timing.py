# SPDX-License-Identifier: MIT
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MODULES = sorted(
    path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    for path in (ROOT / "benchmarks").rglob("*.py")
    if "limit_threads(" in path.read_text(encoding="utf-8")
)
# Threads are fixed before what is heavy is imported; that is refused here.
CODE = """
import importlib, os, sys
class Stop:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("pinwm_drake", "torch", "numba"):
            raise ImportError
sys.meta_path.insert(0, Stop())
def state():
    return os.sched_getaffinity(0), [name for name in os.environ if name.endswith("_NUM_THREADS")]
before = state()
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except ImportError:
        pass
print(before == state())
"""


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="needs Linux")
def test_what_imports_a_benchmark_keeps_its_cores_and_threads():
    """Tests import benchmarks: all workers of pytest would share the core that a benchmark binds its process to."""
    assert len(MODULES) > 10
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    command = [sys.executable, "-c", CODE, *MODULES]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "True"
