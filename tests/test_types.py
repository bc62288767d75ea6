# SPDX-License-Identifier: MIT
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CALLS = (  # an import, a right call, a wrong one, and what mypy says of it
    ("systems.sampling import period_index", "period_index(0.5, 0.1)", 'period_index("0.5", 0.1)', "arg-type"),
    ("models import policy_path", 'policy_path("push_t")', "policy_path(1)", "arg-type"),
    ("models import model_names", "model_names().sort()", "model_names().values()", "attr-defined"),
)


def mypy(*paths: Path) -> str:
    """Return what mypy, set as for the package and with its cache, says of a user's code."""
    command = [sys.executable, "-m", "mypy", *map(str, paths)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout


def test_a_wrong_call_across_the_border_of_a_top_level_folder_fails_mypy(tmp_path):
    imports = "; ".join(f"from pinwm_drake.{module}" for module, *_ in CALLS)
    for name, number in (("right", 1), ("wrong", 2)):
        (tmp_path / f"{name}.py").write_text("\n".join([imports, *(call[number] for call in CALLS)]) + "\n")
    said = mypy(tmp_path / "right.py", tmp_path / "wrong.py")
    assert f"Found {len(CALLS)} errors in 1 file (checked 2 source files)" in said
    for line, (_, _, _, error) in enumerate(CALLS, start=2):
        assert any(f"wrong.py:{line}: error" in one and f"[{error}]" in one for one in said.splitlines()), said
