# SPDX-License-Identifier: MIT
"""Pages of the Python API, one a package, which mkdocstrings fills from the docstrings."""

import ast
from pathlib import Path

_PACKAGE = "pinwm_drake"
_COMMANDS = "pinwm_drake.cli"  # has pages of its own


def public_modules(root: Path) -> dict[str, list[str]]:
    """Return the public modules of each package, without the package itself, in alphabetical order.

    A package or module whose name begins with an underscore, and the command line, are not public.

    Args:
        root: Folder that holds the package.
    """
    found: dict[str, list[str]] = {}
    for package in _packages(root / _PACKAGE, _PACKAGE):
        folder = root.joinpath(*package.split("."))
        files = (path.stem for path in folder.glob("*.py") if path.stem != "__init__")
        found[package] = [f"{package}.{stem}" for stem in sorted(files) if not stem.startswith("_")]
    return found


def _packages(folder: Path, name: str) -> list[str]:
    inner = [
        package
        for path in sorted(folder.iterdir())
        if path.name[0] not in "_." and (path / "__init__.py").exists() and f"{name}.{path.name}" != _COMMANDS
        for package in _packages(path, f"{name}.{path.name}")
    ]
    return [name, *inner]


def face(root: Path) -> dict[str, str]:
    """Return the public names of `import pinwm_drake`, each with the module that defines it."""
    stub = ast.parse((root / _PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))
    found = {}
    for node in stub.body:
        if isinstance(node, ast.ImportFrom):
            found |= {name.asname or name.name: f"{_PACKAGE}.{node.module}" for name in node.names}
    return dict(sorted(found.items()))


def page_of(package: str) -> str:
    """Return the path in the site of a package's page."""
    return f"reference/api/{package.removeprefix(f'{_PACKAGE}.')}.md"


def api_pages(root: Path) -> dict[str, str]:
    """Return the Markdown of every page of the API by its path in the site.

    Args:
        root: Folder that holds the package.
    """
    packages = public_modules(root)
    pages = {page_of(package): _package_page(root, package, modules) for package, modules in packages.items()}
    pages[page_of(_PACKAGE)] = _face_page(root, packages[_PACKAGE])
    pages["reference/api/index.md"] = _index(root, packages)
    return pages


def _index(root: Path, packages: dict[str, list[str]]) -> str:
    rows = [
        f"| [{package}]({Path(page_of(package)).name}) | {_about(root, package)} |"
        for package, modules in packages.items()
        if modules
    ]
    return "\n".join(
        [
            "# Python API",
            "",
            "This page is for people who call `pinwm_drake` from Python. Each package has a page with its public",
            "modules, and each function states shape, unit and frame of every array.",
            "",
            "Start with the [names of `import pinwm_drake`](pinwm_drake.md).",
            "",
            "| package | holds |",
            "| --- | --- |",
            *rows,
            "",
        ]
    )


def _package_page(root: Path, package: str, modules: list[str]) -> str:
    lines = [f"# {package.removeprefix(f'{_PACKAGE}.')}", "", _about(root, package), ""]
    if not modules:
        lines += ["This package holds folders only.", ""]
    source = root.joinpath(*package.split("."), "__init__.py").read_text(encoding="utf-8")
    own = [package] if any(isinstance(node, ast.FunctionDef) for node in ast.parse(source).body) else []
    return "\n".join([*lines, *(f"::: {module}\n" for module in own + modules)])


def _face_page(root: Path, modules: list[str]) -> str:
    names = face(root)
    rows = [
        f"| [`{name}`][{module}.{name}] | `{module.removeprefix(f'{_PACKAGE}.')}` | {_about_name(root, module, name)} |"
        for name, module in names.items()
    ]
    return "\n".join(
        [
            f"# {_PACKAGE}",
            "",
            "`import pinwm_drake as pw` offers these names. A module is loaded when its name is used.",
            "",
            "| name | defined in | is or does |",
            "| --- | --- | --- |",
            *rows,
            "",
            "The modules at the top of the package follow.",
            "",
            *(f"::: {module}\n" for module in modules),
        ]
    )


def _about(root: Path, package: str) -> str:
    """Return the first line of a package's docstring."""
    source = root.joinpath(*package.split("."), "__init__.py").read_text(encoding="utf-8")
    return _first_line(ast.get_docstring(ast.parse(source)))


def _about_name(root: Path, module: str, name: str) -> str:
    """Return the first line of the docstring of a function, class or constant."""
    place = root.joinpath(*module.split("."))
    source = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    body = ast.parse(source.read_text(encoding="utf-8")).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and node.name == name:
            return _first_line(ast.get_docstring(node))
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and isinstance(after, ast.Expr) and _assigns(node, name):
            return _first_line(str(getattr(after.value, "value", "")))
    return ""


def _assigns(node: ast.Assign | ast.AnnAssign, name: str) -> bool:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    return any(isinstance(target, ast.Name) and target.id == name for target in targets)


def _first_line(docstring: str | None) -> str:
    return (docstring or "").partition("\n")[0].replace("|", "\\|")
