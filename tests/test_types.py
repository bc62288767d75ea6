# SPDX-License-Identifier: MIT
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Folder of the user's code, and of a cache that all runs share."""
    return tmp_path_factory.mktemp("mypy")


def mypy(code: str, folder: Path) -> str:
    """What mypy, set as for the package, says of a user's code."""
    (folder / "user.py").write_text(code)
    command = [sys.executable, "-m", "mypy", "--cache-dir", str(folder / "cache"), str(folder / "user.py")]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False).stdout


@pytest.mark.parametrize(
    ("module", "good", "wrong", "said"),
    [
        ("systems.sampling import period_index", "period_index(0.5, 0.1)", 'period_index("0.5", 0.1)', "arg-type"),
        ("models import policy_path", 'policy_path("push_t")', "policy_path(1)", "arg-type"),
        ("models import model_names", "model_names().sort()", "model_names().values()", "attr-defined"),
    ],
)
def test_a_wrong_call_across_the_border_of_a_top_level_folder_fails_mypy(folder, module, good, wrong, said):
    assert "Success" in mypy(f"from pinwm_drake.{module}\n{good}", folder)
    assert f"[{said}]" in mypy(f"from pinwm_drake.{module}\n{wrong}", folder)
