# SPDX-License-Identifier: MIT
"""Every `pinwm ...` on a page is one that the command line takes; nothing is run."""

import difflib
import re
import shlex
from pathlib import Path

import nbformat
import pytest

from pinwm_drake.errors import PinwmError
from pinwm_drake.request import make_request
from tests.docs.pages import NOTEBOOKS, PAGES, content, hook, name_of

COMMANDS = hook("cli_pages").commands()
_ROOT = ("-h", "--help", "--version", "--install-completion", "--show-completion")
_END = re.compile(r"^[|;&]+$|^\d?>>?$|^<$")


def lines_of(text: str) -> list[str]:
    """Lines of a snippet that begin with `pinwm`, after a prompt or a variable, those that a backslash parts joined."""
    whole = re.sub(r" *\\\n\s*", " ", text)
    found = (
        re.match(r"^\s*(?:[$!%] *)?(?:\w+=\S+ +)*(?:\.venv/bin/)?(pinwm [a-z-].*)$", line)
        for line in whole.splitlines()
    )
    return [line[1] for line in found if line]


def inline(text: str) -> list[str]:
    """Commands in the prose of Markdown, between backticks."""
    prose = re.sub(r"(?<!\n)\n(?!\n)", " ", "\n".join(content(text).prose))
    return re.findall(r"(?<!`)`(pinwm [a-z-][^`]*)`(?!`)", prose)


def parsed(line: str) -> tuple[str, list[str]]:
    """Name of a command, and its arguments up to a pipe, another command or a comment."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
    lexer.whitespace_split, lexer.commenters = True, "#"
    tokens: list[str] = []
    for token in list(lexer)[1:]:
        if _END.match(token):
            break
        tokens.append(token)
    name = ""
    while tokens and f"{name} {tokens[0]}".strip() in COMMANDS:
        name = f"{name} {tokens.pop(0)}".strip()
    return name, tokens


def options_fault(line: str) -> str:
    """Fault of the name and the options of a command that may lack its arguments; empty without one."""
    name, tokens = parsed(line)
    if not name and tokens[0].startswith("-"):
        return "" if tokens[0] in _ROOT else f"no option {tokens} of pinwm"
    if not name:
        near = difflib.get_close_matches(line.split()[1], COMMANDS)
        return f"no such command; allowed: {', '.join(near) or 'those of pinwm --help'}"
    known = {"-h", "--help"}
    known |= {one for parameter in COMMANDS[name].params for one in (*parameter.opts, *parameter.secondary_opts)}
    wrong = [one for one in tokens if re.match(r"--?[A-Za-z]", one) and one.partition("=")[0] not in known]
    return f"no option {wrong} of pinwm {name}" if wrong else ""


def fault(line: str) -> str:
    """Fault of a whole command: of its options, of a value, or of arguments that are missing; empty without one."""
    name, tokens = parsed(line)
    if (found := options_fault(line)) or not name or {"-h", "--help"} & set(tokens):
        return found
    command = COMMANDS[name]
    if "..." in tokens or "--config" in tokens or (getattr(command, "commands", None) and not tokens):
        return ""
    try:
        values = command.make_context(f"pinwm {name}", tokens).params
        if request := getattr(command.callback, "request", None):
            values.pop("config")
            make_request(request, {key: value for key, value in values.items() if value is not None})
    except PinwmError as error:
        return str(error)
    except Exception as error:  # of typer's own copy of click
        return f"{type(error).__name__}: {error}"
    return ""


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_of_a_page_are_taken(page):
    text = page.read_text(encoding="utf-8")
    faults = {line: fault(line) for snippet in content(text).snippets for line in lines_of(snippet.text)}
    faults |= {line: options_fault(line) for line in inline(text)}
    assert {line: found for line, found in faults.items() if found} == {}


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=name_of)
def test_commands_of_a_notebook_are_taken(notebook: Path):
    faults = {}
    for cell in nbformat.read(notebook, as_version=4).cells:
        if cell.cell_type == "code":
            faults |= {line: fault(line) for line in lines_of(cell.source)}
        else:
            faults |= {line: options_fault(line) for line in inline(cell.source)}
    assert {line: found for line, found in faults.items() if found} == {}


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("pinwm train out/twin -o out/policy; then: more", ""),
        ("pinwm capture import colmap a b --mesh c.obj > log.txt", ""),
        ("pinwm train --help", ""),
        ("pinwm --version", ""),
        ("pinwm --verbose", "no option ['--verbose'] of pinwm"),
        ("pinwm next-push out/twin -o out/next", ""),
        ("pinwm trian out/twin", "no such command; allowed: train"),
        ("pinwm train out/twin --seeds 1", "no option ['--seeds'] of pinwm train"),
        ("pinwm identify out/capture", "MissingParameter: Missing parameter: twin"),
        ("pinwm identify a b --starts 0", "--starts: got 0; allowed: 1 to 1000"),
    ],
)
def test_a_wrong_command_is_found(line, found):
    assert fault(line) == found


def test_commands_are_found_in_snippets_and_prose():
    text = (
        "See `pinwm\ndemo`.\n\n    $ pinwm train a \\\n        -o b   # why\n    pinwm: an error\n\n`pinwm COMMAND`\n"
    )
    assert [line for snippet in content(text).snippets for line in lines_of(snippet.text)] == [
        "pinwm train a -o b   # why"
    ]
    assert inline(text) == ["pinwm demo"]
