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


def mypy(path: Path, calls: list[str]) -> str:
    """Return what mypy, set as for the package and with its cache, says of a user's code, one call a line."""
    imports = "; ".join(f"from pinwm_drake.{module}" for module, *_ in CALLS)
    path.write_text("\n".join([imports, *calls]) + "\n")
    command = [sys.executable, "-m", "mypy", str(path)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout


def test_a_wrong_call_across_the_border_of_a_top_level_folder_fails_mypy(tmp_path):
    assert "Success" in mypy(tmp_path / "user.py", [right for _, right, _, _ in CALLS])
    said = mypy(tmp_path / "user.py", [wrong for _, _, wrong, _ in CALLS])
    for line, (_, _, _, error) in enumerate(CALLS, start=2):
        assert any(f"user.py:{line}: error" in one and f"[{error}]" in one for one in said.splitlines()), said
