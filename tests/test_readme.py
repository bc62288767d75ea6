import re
from pathlib import Path

import pytest
import torch

README = Path(__file__).resolve().parent.parent / "README.md"


def test_the_python_example_runs_and_does_what_it_says(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    names: dict = {}
    exec(compile(example, README.name, "exec"), names)
    assert "tensor" in capsys.readouterr().out
    # The pusher starts 5 mm before the face and moves 100 mm; contacts give by far less than 10 µm.
    assert names["end"].p_WB[0, 0, 0].item() == pytest.approx(0.095, abs=1e-5)
    # Moving faster by dv for this 1 s takes the cube further by dv · 1 s.
    assert names["V_WP"].grad[:, 0, 3].sum().item() == pytest.approx(1.0, abs=1e-4)
    assert torch.isfinite(names["V_WP"].grad).all()


def test_the_files_it_points_to_are_there():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", README.read_text()):
        assert (README.parent / target).is_file(), target
