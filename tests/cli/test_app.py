# SPDX-License-Identifier: MIT
import subprocess
import sys
from pathlib import Path

import pytest

import pinwm_drake

ROOT = Path(__file__).resolve().parents[2]


def test_version(pinwm):
    assert pinwm("--version") == (0, f"pinwm {pinwm_drake.__version__}\n", "")


@pytest.mark.parametrize(
    ("command", "example"),
    [((), "pinwm demo"), (("demo",), "pinwm demo"), (("demo", "push"), "pinwm demo push")],
)
def test_help_shows_an_example(pinwm, command, example):
    code, output, _ = pinwm(*command, "--help")
    assert code == 0
    assert f"Example: {example}" in output


@pytest.mark.parametrize(
    "arguments",
    [("no-such-command",), ("demo", "push", "--no-such-option"), ("demo", "push", "--friction", "slippery"), ()],
)
def test_a_senseless_command_line_exits_with_2(pinwm, arguments):
    code, output, errors = pinwm(*arguments)
    assert code == 2
    assert "Usage: pinwm" in output + errors


@pytest.mark.parametrize("command", [["demo"], ["demo", "push"]])
def test_help_loads_nothing_heavy(command):
    code = f"""
import sys
from pinwm_drake.cli import main
sys.argv = ["pinwm", *{command}, "--help"]
try:
    main()
finally:
    heavy = ("torch", "numba", "pydrake", "matplotlib", "cv2", "trimesh")
    print([name for name in heavy if name in sys.modules])
"""
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "[]"
