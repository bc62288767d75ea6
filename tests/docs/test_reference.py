# SPDX-License-Identifier: MIT
"""The pages that are made from the code: commands and API."""

import ast
import re
from collections.abc import Iterator

import pytest

import pinwm_drake as pw
from tests.docs.pages import ROOT, hook

API = hook("api_pages").api_pages(ROOT)
CLI, COMMANDS = hook("cli_pages").cli_pages(), hook("cli_pages").commands()


def test_every_public_module_is_on_a_page():
    shown = {name for page in API.values() for name in re.findall(r"^::: (\S+)$", page, re.MULTILINE)}
    modules = set()
    for folder, package in (
        ("pinwm_drake", "pinwm_drake"),
        ("systems", "pinwm_drake.systems"),
        ("models", "pinwm_drake.models"),
    ):
        for path in (ROOT / folder).rglob("*.py"):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            if path.resolve() == path.absolute() and not any(part.startswith("_") for part in parts):
                modules.add(".".join((package, *parts)))
    commands = {name for name in modules if name.startswith("pinwm_drake.cli")}
    assert commands
    # `models` defines functions in the package itself.
    assert shown == modules - commands | {"pinwm_drake.models"}


def functions(text: str) -> Iterator[ast.FunctionDef]:
    """Functions of a module and methods of its classes that are public and have a docstring."""
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from (one for one in node.body if isinstance(one, ast.FunctionDef) and described(one))
        elif isinstance(node, ast.FunctionDef) and described(node):
            yield node


def described(node: ast.FunctionDef) -> bool:
    return not node.name.startswith("_") and ast.get_docstring(node) is not None


def without_shape(text: str) -> list[str]:
    """Functions of a module that take an array, and tell no shape in words or by another docstring."""
    found = []
    for node in functions(text):
        kinds = [ast.unparse(one.annotation) for one in (*node.args.args, *node.args.kwonlyargs) if one.annotation]
        if any(re.fullmatch(r"(np\.ndarray|(torch\.)?Tensor)( \| None)?", kind) for kind in kinds):
            shape = r"\([^()]*[\w.*],?[^()]*\)|\b[Aa]s for |\bsee `|the same shape|[Ss]calar"
            if not re.search(shape, ast.get_docstring(node) or ""):
                found.append(node.name)
    return found


def test_every_array_that_a_function_takes_has_a_shape():
    modules = [module for found in hook("api_pages").public_modules(ROOT).values() for module in found]
    texts = {name: ROOT.joinpath(*name.split(".")).with_suffix(".py").read_text(encoding="utf-8") for name in modules}
    assert {name: missing for name, text in texts.items() if (missing := without_shape(text))} == {}
    assert without_shape('def f(a: np.ndarray):\n    """Return an image."""\n') == ["f"]
    assert without_shape('def f(a: np.ndarray):\n    """Return a (n, 3) m."""\n') == []


def test_every_page_of_the_api_is_in_its_index():
    index = API["reference/api/index.md"]
    for place, page in API.items():
        assert (
            place == "reference/api/index.md"
            or f"({place.removeprefix('reference/api/')})" in index
            or ":::" not in page
        )


def test_the_names_of_the_face_are_on_its_page():
    page = API["reference/api/pinwm_drake.md"]
    for name in pw.__all__:
        if name == "__version__":
            continue
        row = re.search(rf"^\| \[`{name}`\]\[pinwm_drake\.(\S+)\.{name}\] \| `(\S+)` \| (.*) \|$", page, re.MULTILINE)
        assert row, name
        assert row[1] == row[2]
        assert row[3], f"{name} has no docstring"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_on_the_page_of_its_command(name):
    page = CLI[f"reference/cli/{name.split()[0]}.md"]
    start = page.index(f"# pinwm {name}\n")
    section = page[start : end if (end := page.find("# pinwm", start + 3)) > 0 else len(page)]
    for parameter in COMMANDS[name].params:
        if parameter.name != "help" and not parameter.hidden:
            named = parameter.metavar if parameter.param_type_name == "argument" else parameter.opts[0]
            assert f"`{named}`" in section
    assert f"`pinwm {name}`" in CLI["reference/cli/index.md"]


def test_a_row_has_values_unit_default_and_help():
    page = CLI["reference/cli/identify.md"]
    assert "| `CAPTURE` |" in page[page.index("**Arguments**") :]
    row = next(line for line in page.splitlines() if line.startswith("| `--time-step`"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[1:3] == ["1e-05 to 0.1", "s"]
    assert cells[3].startswith("1/240")
    assert cells[4].startswith("Time step of the physics")
    assert page.index("**Advanced**") < page.index(row)
    assert "| `--support` | auto, corners, patch |  | auto |" in page
    # A group without units has no column for them.
    assert "| `--episode` | text, again for each | the first |" in page


def test_an_entry_for_several_names_becomes_one_for_each():
    text = (
        "A box.\n\nArgs:\n    low, high: (3,) m, corners;\n        world.\n    other: One.\n\nReturns:\n    a, b: stay."
    )
    assert hook("docstrings").separated(text) == (
        "A box.\n\nArgs:\n    low: (3,) m, corners;\n        world.\n    high: (3,) m, corners;\n        world.\n\n"
        "    other: One.\n\nReturns:\n    a, b: stay."
    )


def test_the_comment_of_a_constant_is_its_docstring():
    comment_of = hook("docstrings").comment_of
    assert comment_of(["SIZE = 5.0  # m, of a pusher"]) == "m, of a pusher"
    assert comment_of(['KIND = "#"  # type: ignore[misc]']) == ""
