# SPDX-License-Identifier: MIT
import ast
import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest

import pinwm_drake as pw

ROOT = Path(__file__).resolve().parent.parent
NAMES = [
    "load_capture",
    "check_capture",
    "capture_path",
    "align",
    "FitOptions",
    "identify",
    "IdentifyOptions",
    "load_twin",
    "predict",
    "next_push",
    "load_setup",
    "Place",
    "make_station",
    "make_meshcat",
    "inline_page",
    "simulate",
    "SessionOptions",
    "crosscheck",
    "CrossCheckOptions",
    "draw_cousins",
    "make_control_loop",
    "train",
    "evaluate",
    "export_bundle",
    "read_bundle",
    "Runner",
    "Parameters",
    "State",
    "Stepper",
    "render",
]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_leads_to_what_is_called_so(name):
    found = getattr(pw, name)
    assert found.__name__ == name
    assert name in dir(pw)


def test_there_is_no_other_name():
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = pw.no_such_name


def test_packages_hand_on_no_names():
    handed = {}
    for folder in ("pinwm_drake", "systems", "models"):
        for path in (ROOT / folder).rglob("__init__.py"):
            if path.resolve() != path.absolute() or path == ROOT / "pinwm_drake/__init__.py":
                continue
            imports = [node for node in ast.parse(path.read_text()).body if isinstance(node, ast.ImportFrom)]
            inside = [node.module for node in imports if (node.module or "").startswith("pinwm_drake")]
            if [module for module in inside if module != "pinwm_drake.errors"]:
                handed[str(path)] = inside
    assert handed == {}


def test_the_import_is_light():
    code = (
        "import sys, pinwm_drake; print([n for n in ('torch', 'numpy', 'pydrake', 'matplotlib') if n in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert run.stdout.strip() == "[]"


def test_a_prediction_loads_neither_drake_nor_plotting():
    code = (
        "import sys, pinwm_drake as pw; pw.predict; print([n for n in ('pydrake', 'matplotlib') if n in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert run.stdout.strip() == "[]"


def test_the_names_of_gymnasium_are_registered():
    assert {"push", "flip"} <= set(pw.ENV_IDS)
    assert all(name in gymnasium.registry for name in pw.ENV_IDS.values())
