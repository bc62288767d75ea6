# SPDX-License-Identifier: MIT
"""The task of docs/how-to/own-task.md: it is copied from the page, tried in an environment, and trained for a round."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from pinwm_drake.tasks import registry

PAGE = Path(__file__).resolve().parents[2] / "docs/how-to/own-task.md"
TASK, TRY, ROUND, _, SCRIPT = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Folder with slide.py, in which and from which Python runs."""
    (tmp_path / "slide.py").write_text(TASK, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(registry, "_TASKS", dict(registry._TASKS))
    yield tmp_path
    sys.modules.pop("slide", None)


def run(code):
    names: dict = {}
    exec(compile(code, PAGE.name, "exec"), names)
    return names


def test_it_has_fewer_than_60_lines():
    assert len(TASK.splitlines()) < 60


def test_the_environment_pays_for_the_way_to_the_line(folder, capsys):
    names = run(TRY)
    assert names["env"].task == names["slide"].SlideTask(line=0.2)
    assert capsys.readouterr().out in PAGE.read_text(encoding="utf-8")
    # A world whose object came 10 mm nearer, with the pusher at the same distance: 0.1, less 0.01 for the action.
    task, state, p_WP = names["env"].task, np.zeros((1, 13)), np.zeros((1, 3))
    before, state[0, 4], p_WP[0, 0] = task.measure(state, p_WP), 0.01, 0.01
    np.testing.assert_allclose(task.rewards(before, task.measure(state, p_WP)), [0.1 - 0.01])
    # At rest on the line is a success, and its state is near the goal.
    state[0, 4] = 0.2
    assert task.measure(state, p_WP).success.all()
    assert task.near_goal(task.state(state, p_WP)[0])


@pytest.mark.nightly
def test_a_round_is_trained_and_its_policy_can_be_read(folder, capsys):
    names = run(ROUND)
    task = names["slide"].SlideTask()
    assert names["policy"].spec.task == task
    assert names["policy"].spec.max_steps == 60
    assert capsys.readouterr().out.strip() in PAGE.read_text(encoding="utf-8")
    assert (folder / "out/try/weights.npz").exists()
    from pinwm_drake.learning.policy import read_policy

    assert read_policy(folder / "out/try").spec.task == task


def test_the_script_knows_the_task(folder, monkeypatch):
    monkeypatch.setattr(
        sys, "argv", ["mypinwm.py", "train", "push_t", "--task", "slide", "--image-size", "0", "-o", "out"]
    )
    with pytest.raises(SystemExit):
        run(SCRIPT)
    assert "slide" in registry.task_names()
