# SPDX-License-Identifier: MIT
import ast
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import pytest

from pinwm_drake.errors import ParameterError
from pinwm_drake.tasks import DEFAULT_TASK, registry
from pinwm_drake.tasks.flip import FlipTask
from pinwm_drake.tasks.push import PushTask
from pinwm_drake.tasks.recipe import Recipe
from pinwm_drake.tasks.registry import changed_task, recipe_of, register, task_from_document, task_names

ROOT = Path(__file__).resolve().parents[2]
NAMES = {"push", "flip"}
MODULES = {f"pinwm_drake.tasks.{folder}{name}" for folder in ("", "recipes.") for name in NAMES}
# The planner of planar pushes is of the push task alone; the paper lists its rows by task, and a demo shows one.
FREE = ("pinwm_drake/tasks", "pinwm_drake/paper", "pinwm_drake/demo")
FREE += tuple(f"systems/mpc/{name}.py" for name in ("controller", "model", "planner", "policy"))


def leaks(text: str) -> Iterator[str]:
    """What in a module tells push from flip: an import of a task or its recipe, or a comparison with its name."""
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Import():
                yield from (f"{node.lineno}: {alias.name}" for alias in node.names if alias.name in MODULES)
            case ast.ImportFrom(module=str(module)):
                found = {module, *(f"{module}.{alias.name}" for alias in node.names)} & MODULES
                yield from (f"{node.lineno}: {name}" for name in found)
            case ast.Compare() | ast.MatchValue():
                constants = [one.value for one in ast.walk(node) if isinstance(one, ast.Constant)]
                yield from (f"{node.lineno}: {value}" for value in constants if value in NAMES)


def test_nothing_outside_the_tasks_tells_them_apart():
    found = []
    for folder in ("pinwm_drake", "systems", "models"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            file = path.relative_to(ROOT).as_posix()
            if path.resolve() == path.absolute() and not file.startswith(FREE):
                found += [f"{file}:{leak}" for leak in leaks(path.read_text(encoding="utf-8"))]
    assert found == []


@pytest.mark.parametrize(
    ("text", "leak"),
    [
        ("from pinwm_drake.tasks.push import PushTask", "1: pinwm_drake.tasks.push"),
        ("from pinwm_drake.tasks import flip", "1: pinwm_drake.tasks.flip"),
        ("def f():\n    import pinwm_drake.tasks.recipes.flip", "2: pinwm_drake.tasks.recipes.flip"),
        ("same = task.name == 'flip'", "1: flip"),
        ("same = task in (None, 'push')", "1: push"),
        ("match name:\n    case 'flip':\n        pass", "2: flip"),
    ],
)
def test_a_leak_is_found(text, leak):
    assert list(leaks(text)) == [leak]
    assert not list(leaks("from pinwm_drake.tasks.registry import recipe_of\nkind = {'push': 1}[recipe_of(x).motion]"))


def test_the_shipped_tasks_have_recipes_and_one_is_the_default():
    assert set(task_names()) >= NAMES
    assert DEFAULT_TASK in NAMES
    assert recipe_of(PushTask()) is recipe_of("push")
    assert (recipe_of("push").planner, recipe_of("flip").planner) == ("outline", "sampling")
    assert (recipe_of("push").motion, recipe_of("flip").motion) == ("push", "poke")
    assert task_names("goal_range") == ["push"]
    with pytest.raises(ParameterError, match=r"task: got 'juggle'; allowed: .*flip.*push"):
        recipe_of("juggle")


def test_another_task_has_the_default_recipe_or_its_own(monkeypatch):
    monkeypatch.setattr(registry, "_TASKS", dict(registry._TASKS))

    @register
    class Roll(FlipTask):
        name: ClassVar[str] = "roll"

    assert recipe_of(Roll()) == Recipe()
    assert task_from_document({"name": "roll"}) == Roll()
    register(Roll, Recipe(algorithm="ppo"))
    assert recipe_of("roll").algorithm == "ppo"


def test_changes_are_fields_or_another_task():
    task = PushTask(tolerance=0.01)
    assert changed_task(task, None) == task
    assert changed_task(task, {"bonus": 3.0}) == PushTask(tolerance=0.01, bonus=3.0)
    assert changed_task(task, {"name": "flip", "room": 0.3}) == FlipTask(room=0.3)
    assert changed_task(task, FlipTask()) == FlipTask()
