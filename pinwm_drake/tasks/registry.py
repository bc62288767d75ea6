# SPDX-License-Identifier: MIT
"""Tasks and their recipes by name: those that ship, and what `register` adds."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from pinwm_drake.errors import ParameterError
from pinwm_drake.tasks.flip import FlipTask
from pinwm_drake.tasks.push import PushTask
from pinwm_drake.tasks.recipe import Recipe
from pinwm_drake.tasks.recipes.flip import FLIP
from pinwm_drake.tasks.recipes.push import PUSH
from pinwm_drake.tasks.task import Task
from pinwm_drake.validation import check_fields

TaskClass = TypeVar("TaskClass", bound=type[Task])
_TASKS: dict[str, tuple[type[Task], Recipe]] = {PushTask.name: (PushTask, PUSH), FlipTask.name: (FlipTask, FLIP)}


def register(task: TaskClass, recipe: Recipe | None = None) -> TaskClass:
    """Make a task known by its name; a class decorator where the default recipe does.

    Args:
        task: Class of the task.
        recipe: Its recipe; None for the default one.
    """
    _TASKS[task.name] = task, recipe or Recipe()
    return task


def recipe_of(task: Task | str) -> Recipe:
    """Recipe of a task, or of the task of a name.

    Raises:
        ParameterError: There is no such task.
    """
    name = task if isinstance(task, str) else task.name
    if name not in _TASKS:
        raise ParameterError(f"task: got {name!r}; allowed: {', '.join(sorted(_TASKS))}")
    return _TASKS[name][1]


def task_names(field: str | None = None) -> list[str]:
    """Names of the known tasks, or of those that have a field, such as "goal_range"; the ones that ship first."""
    return [name for name, (kind, _) in _TASKS.items() if field is None or field in _fields(kind)]


def task_from_document(document: Any) -> Task:
    """Return the task that `Task.to_document` described; fields that are left out have their defaults.

    Args:
        document: A mapping with "name" and any of the fields.

    Raises:
        ParameterError: There is no such task or field, or a value is of the wrong kind or out of range.
    """
    given = document.get("name") if isinstance(document, Mapping) else document
    if not isinstance(document, Mapping) or not isinstance(given, str) or given not in _TASKS:
        allowed = f"a mapping whose name is one of {', '.join(sorted(_TASKS))}"
        raise ParameterError(f"task: got {given!r}; allowed: {allowed}")
    kind, _ = _TASKS[document["name"]]
    known, values = _fields(kind), {name: value for name, value in document.items() if name != "name"}
    if unknown := [name for name in values if name not in known]:
        raise ParameterError(f"task.{unknown[0]}: got an unknown key; allowed: {', '.join(known)}")
    task = kind(**values)
    check_fields(task, "task.", as_given=True)
    return task


def changed_task(task: Task, changes: Task | Mapping[str, Any] | None) -> Task:
    """Return a task with some fields changed, or another one where the changes are one or name it.

    Args:
        task: The task.
        changes: Another task; or fields by name, and "name" where that is another one; or None.

    Raises:
        ParameterError: There is no such task or field, or a value is of the wrong kind or out of range.
    """
    if isinstance(changes, Task):
        return changes
    same = not changes or changes.get("name", task.name) == task.name
    return task_from_document({**(task.to_document() if same else {}), **(changes or {})})


def _fields(kind: type[Task]) -> list[str]:
    return [field.name for field in fields(kind)]  # type: ignore[arg-type]
