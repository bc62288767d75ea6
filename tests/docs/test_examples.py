# SPDX-License-Identifier: MIT
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

import pinwm_drake as pw

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
STATION, PYTHON = (ROOT / "docs/reference" / name for name in ("station.md", "python.md"))


def run_example(page, number, of):
    """The names that one of a page's examples, of which there are so many, defines."""
    examples = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert len(examples) == of
    names: dict = {}
    exec(compile(examples[number], page.name, "exec"), names)
    return names


def test_the_readmes_example_runs_and_does_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pw, "EvaluateRequest", partial(pw.EvaluateRequest, max_steps=2))  # of a hundred
    names = run_example(README, 0, of=1)
    # The pusher goes 100 mm in a second and takes the block with it; more friction on the floor stops that sooner.
    assert names["end"].p_WB[0, 0, 0] > 0.01
    gradient = names["theta"].friction.grad
    assert gradient.shape == (1, 2)
    assert torch.isfinite(gradient).all()
    assert gradient[0, 0] != 0.0
    # The capture says how far the block went in its second push.
    truth = names["prediction"].episode.object_poses.p_WO
    moved = float(np.linalg.norm(truth[-1] - truth[0]))
    assert abs(names["prediction"].motion[0] - moved) < 0.005
    assert names["station"].HasOutputPort("rgb")
    assert names["evaluation"].episodes == 1


def test_the_stations_example_runs_and_does_what_it_says():
    names = run_example(STATION, 0, of=2)
    state = names["station"].GetOutputPort("pusher_state")
    moved = state.Eval(names["context"])[:3] - state.Eval(names["station"].CreateDefaultContext())[:3]
    # 0.1 m/s for 0.5 s, less the time that it takes to get there.
    np.testing.assert_allclose(moved, [-0.05, 0.0, 0.0], atol=0.005)


def test_the_environments_example_runs_and_does_what_it_says(capsys):
    names = run_example(STATION, 1, of=2)
    assert names["observation"].shape == names["environment"].observation_space.shape
    assert f"{names['observation'].shape} {names['info']['distance']}" in capsys.readouterr().out
    # The object starts within 8 cm of the goal along each axis; one action of 0.1 s does not take it far.
    assert 0.0 < names["info"]["distance"] < 0.15
    assert np.isfinite(names["reward"])


def test_the_example_of_a_twin_runs_and_does_what_it_says(capsys):
    names = run_example(PYTHON, 1, of=4)
    assert "tensor" in capsys.readouterr().out
    # The pusher goes 100 mm in a second and takes the block with it; more friction on the floor stops that sooner.
    assert names["end"].p_WB[0, 0, 0] > 0.01
    gradient = names["theta"].friction.grad
    assert gradient.shape == (1, 2)
    assert torch.isfinite(gradient).all()
    assert gradient[0, 0] != 0.0


def test_the_renderers_example_runs_and_does_what_it_says(capsys):
    names = run_example(PYTHON, 3, of=4)
    assert "torch.Size([1, 200, 200, 3])" in capsys.readouterr().out
    # The disc's radius is 50 px.
    assert names["image"].alpha[0, 80:120, 80:120].mean() > 0.9
    assert names["image"].alpha[0, :30].max() == 0.0
    # Farther away, the disc covers less of the white background.
    gradient = names["X_CO"].p.grad
    assert torch.isfinite(gradient).all()
    assert gradient[2].abs() > gradient[:2].abs().max()


def test_the_physics_example_runs_and_does_what_it_says(capsys):
    names = run_example(PYTHON, 2, of=4)
    assert "tensor" in capsys.readouterr().out
    # The pusher starts 5 mm before the face and moves 100 mm; contacts give by far less than 10 µm.
    assert names["end"].p_WB[0, 0, 0].item() == pytest.approx(0.095, abs=1e-5)
    # Moving faster by dv for this 1 s takes the cube further by dv · 1 s.
    assert names["V_WP"].grad[:, 0, 3].sum().item() == pytest.approx(1.0, abs=1e-4)
    assert torch.isfinite(names["V_WP"].grad).all()
