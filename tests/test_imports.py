import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

# A line may import only from the lines above it, and from itself. `models` is data with a small accessor.
LINES = (
    {"errors", "files", "jit", "threads"},
    {"checkpoints"},
    {"models"},
    {"spatial"},
    {"geometry"},
    {"physics"},
    {"rendering"},
    {"capture"},
    {"scene"},
    {"twin", "cousins"},
    {"identification"},
    {"learning"},
    {"baselines"},
    {"report"},
    {"systems"},
    {"cli"},
)
RANK = {name: rank for rank, line in enumerate(LINES) for name in line}
# The core is a library of its own: nothing in it may count on the models or the Drake systems.
ONLY_IMPORTED_BY = {"models": {"systems", "cli"}, "systems": {"cli"}}
WITHOUT_DRAKE = {"errors", "checkpoints", "files", "jit", "threads", "spatial", "geometry", "physics", "rendering"}


def modules(root: Path) -> Iterator[tuple[tuple[str, ...], Path]]:
    """The dotted parts below pinwm_drake of every module, and its file."""
    for folder in ("pinwm_drake", "models", "systems"):
        for path in (root / folder).rglob("*.py"):
            parts = path.relative_to(root).with_suffix("").parts
            yield parts[1:] if folder == "pinwm_drake" else parts, path


def imported(parts: tuple[str, ...], path: Path) -> Iterator[str]:
    """The absolute dotted names that a module imports, at its top or inside a function."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            # One dot is the package that holds the module; an __init__ is such a package's own file.
            base = ("pinwm_drake", *parts)[: -node.level] if node.level else ()
            module = ".".join((*base, *filter(None, [node.module])))
            yield from (f"{module}.{alias.name}" for alias in node.names)


def offences(root: Path) -> list[str]:
    """Every import that goes in a forbidden direction, as `file: reason`."""
    found = []
    for parts, path in modules(root):
        here = parts[0]
        if here == "__init__":
            continue
        if here not in RANK:
            found.append(f"{path}: {here} has no line in the layout")
            continue
        for name in imported(parts, path):
            package, _, rest = name.partition(".")
            there = rest.split(".")[0]
            if package == "pydrake" and here in WITHOUT_DRAKE:
                found.append(f"{path}: {here} imports pydrake")
            if package != "pinwm_drake" or there not in RANK or there == here:
                continue
            if RANK[there] > RANK[here]:
                found.append(f"{path}: {here} imports {there}, which stands below it")
            if here not in ONLY_IMPORTED_BY.get(there, {here}):
                found.append(f"{path}: {here} imports {there}, kept for {sorted(ONLY_IMPORTED_BY[there])}")
    return found


def test_imports_go_only_upwards():
    assert offences(ROOT) == []
    assert len(list(modules(ROOT))) > 10


@pytest.mark.parametrize(
    ("file", "line", "reason"),
    [
        ("pinwm_drake/spatial/a.py", "from pinwm_drake.physics import Model", "physics, which stands below"),
        ("pinwm_drake/spatial/a.py", "def f():\n    import pinwm_drake.cli.app", "cli, which stands below"),
        ("pinwm_drake/spatial/a.py", "from .. import geometry", "geometry, which stands below"),
        ("pinwm_drake/spatial/__init__.py", "from ..report import figures", "report, which stands below"),
        ("pinwm_drake/report/a.py", "from pinwm_drake.models import model_path", "kept for"),
        ("pinwm_drake/physics/a.py", "from pydrake.math import RotationMatrix", "imports pydrake"),
        ("pinwm_drake/utils.py", "", "no line in the layout"),
        ("models/__init__.py", "import pinwm_drake.spatial", "spatial, which stands below"),
    ],
)
def test_a_wrong_import_is_found(tmp_path, file, line, reason):
    path = tmp_path / file
    path.parent.mkdir(parents=True)
    path.write_text(line)
    assert len(offences(tmp_path)) == 1
    assert reason in offences(tmp_path)[0]


def run_python(*options: str, cwd: Path) -> str:
    command = [sys.executable, *options]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=True).stdout.strip()


def test_the_package_imports_light():
    heavy = ["torch", "numba", "pydrake", "matplotlib", "numpy", "cv2"]
    code = f"import sys, pinwm_drake; print([name for name in {heavy} if name in sys.modules])"
    assert run_python("-c", code, cwd=ROOT) == "[]"


def test_models_are_found_in_a_checkout_that_is_not_installed():
    # -I leaves out the current folder, -S leaves out site-packages and so any installation.
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import pinwm_drake.models as m; print(m.__file__)"
    assert Path(run_python("-I", "-S", "-c", code, cwd=Path("/"))).resolve() == ROOT / "models" / "__init__.py"
