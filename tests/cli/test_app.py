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


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("evalute", "push_t"), 2, "Did you mean 'evaluate'"),
        (("demo", "psh"), 2, "Did you mean 'push'"),
        (("train", "push_t", "--wolds", "3"), 2, "--worlds"),
        (("simulate", "pusht"), 1, "pusht: no such scenario; allowed: a file, a twin's folder, or one of"),
        (("simulate", "pusht"), 1, "push_t (did you mean push_t?)"),
        (("simulate", "push_t", "--engine", "hydro"), 1, "(did you mean hydroelastic?)"),
        (("report", "t_blck"), 1, "(did you mean t_block?)"),
        (("evaluate", "push_tt"), 1, "(did you mean push_t?)"),
        (("rehearse", "push_t", "--kind", "white image"), 1, "(did you mean white images?)"),
    ],
)
def test_a_wrong_name_is_answered_by_the_nearest_one(pinwm, arguments, code, words):
    got, _, errors = pinwm(*arguments)
    assert got == code
    assert words in " ".join(errors.replace("│", " ").split())


def test_a_wrong_path_is_answered_by_the_nearest_one(pinwm, tmp_path):
    (tmp_path / "twin").mkdir()
    got, _, errors = pinwm("report", str(tmp_path / "twn"))
    assert got == 1
    assert errors.endswith(f"(did you mean {tmp_path / 'twin'}?)\n")


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
