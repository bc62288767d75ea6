# SPDX-License-Identifier: MIT
"""Help of every command: each text stands alone, and a summary fits the list of commands."""

import re
from typing import get_type_hints

import pytest
import typer
from typer.testing import CliRunner

from pinwm_drake.cli.app import _LazyCommand, app

MOST, MOST_SUMMARY = 90, 62  # characters; a summary has one line of a terminal of 80 columns
SUFFIX = re.compile(r"( \([^()]*\))?\.?( \\?\[default: .*\])?$")  # range and default of an option
CHOICES = re.compile(r"\. One of [^.]*$")
# Beginnings of a text that leans on a name or on the text before it.
LEANING = re.compile(r"(Of|That|Which|Whose|It|Its|How|After|Before|Where|With|As|And|Or)\b")


def walk(command, path):
    """Every command below one, with what is typed for it; those that are loaded late are loaded."""
    real = command.callback() if isinstance(command, _LazyCommand) else command
    yield path, real
    for name, inner in getattr(real, "commands", {}).items():
        yield from walk(inner, f"{path} {name}")


COMMANDS = dict(walk(typer.main.get_command(app), "pinwm"))


def texts():
    for path, command in COMMANDS.items():
        for parameter in command.params:
            if parameter.help is not None and not getattr(parameter, "hidden", False):
                yield f"{path} {parameter.opts[0]}", parameter


def test_all_commands_are_walked():
    assert {"pinwm", "pinwm demo push", "pinwm capture import colmap", "pinwm train", "pinwm doctor"} <= set(COMMANDS)
    assert len(list(texts())) > 150


@pytest.mark.parametrize("path", COMMANDS)
def test_a_summary_is_a_short_sentence(path):
    summary = COMMANDS[path].help.strip().split("\n\n")[0].replace("\n", " ")
    assert 0 < len(summary) <= MOST_SUMMARY, f"{len(summary)}: {summary}"
    assert summary[0].isupper()
    assert summary.endswith(".")
    assert not LEANING.match(summary)


def test_every_help_text_stands_alone():
    wrong = []
    for name, parameter in texts():
        text = CHOICES.sub("", SUFFIX.sub("", parameter.help))
        whole = len(text) <= MOST and text[:1].isupper() | text.startswith("`") and not LEANING.match(text)
        wrong += [] if whole and len(text.split()) > 1 else [f"{name}: {len(text)}: {text}"]
    assert wrong == []


def test_options_with_a_unit_show_it_in_brackets():
    from pinwm_drake.experiments.requests.control import ExportRequest
    from pinwm_drake.experiments.requests.train import TrainRequest
    from pinwm_drake.request import request_fields
    from pinwm_drake.validation import unit_of

    for path, request in (("pinwm train", TrainRequest), ("pinwm export", ExportRequest)):
        assert get_type_hints(request)
        shown = {one.name: one.metavar for one in COMMANDS[path].params}
        units = {field.name: unit_of(field.info) for field in request_fields(request)}
        assert sum(unit != "1" for unit in units.values()) > 3
        for name, unit in units.items():
            assert (f"[{unit}]" in shown[name]) == (unit != "1"), (path, name, shown[name])
    shown = [one.metavar for name, one in texts() if name.endswith((" --low", " --box-low", " --goal"))]
    assert set(shown) == {"X Y [m]", "X Y Z [m]", "X Y YAW [m, m, rad]"}


def test_the_help_of_train_fits_two_screens(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = CliRunner().invoke(app, ["train", "--help"])
    assert shown.exit_code == 0
    assert 60 < len(shown.output.splitlines()) <= 100
