import re
from pathlib import Path

import pytest
import torch

README = Path(__file__).resolve().parent.parent / "README.md"


def run_example(number):
    """The names that an example of the README defines."""
    examples = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    assert len(examples) == 3
    names: dict = {}
    exec(compile(examples[number], README.name, "exec"), names)
    return names


def test_the_stations_example_runs_and_does_what_it_says(capsys):
    names = run_example(0)
    assert "(128, 128, 4)" in capsys.readouterr().out
    # At 0.1 m/s for 1 s the pusher goes 100 mm, and takes the T-block with it.
    assert names["station"].object_pose(names["context"]).translation()[0] < -0.01


def test_the_renderers_example_runs_and_does_what_it_says(capsys):
    names = run_example(2)
    assert "torch.Size([1, 200, 200, 3])" in capsys.readouterr().out
    # The disc's radius is 50 px.
    assert names["image"].alpha[0, 80:120, 80:120].mean() > 0.9
    assert names["image"].alpha[0, :30].max() == 0.0
    # Farther away, the disc covers less of the white background.
    gradient = names["X_CO"].p.grad
    assert torch.isfinite(gradient).all()
    assert gradient[2].abs() > gradient[:2].abs().max()


def test_the_python_example_runs_and_does_what_it_says(capsys):
    names = run_example(1)
    assert "tensor" in capsys.readouterr().out
    # The pusher starts 5 mm before the face and moves 100 mm; contacts give by far less than 10 µm.
    assert names["end"].p_WB[0, 0, 0].item() == pytest.approx(0.095, abs=1e-5)
    # Moving faster by dv for this 1 s takes the cube further by dv · 1 s.
    assert names["V_WP"].grad[:, 0, 3].sum().item() == pytest.approx(1.0, abs=1e-4)
    assert torch.isfinite(names["V_WP"].grad).all()


def test_the_files_it_points_to_are_there():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", README.read_text()):
        assert (README.parent / target).is_file(), target
