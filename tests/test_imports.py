# SPDX-License-Identifier: MIT
import ast
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

# A line may import only from the lines above it, and from itself. `models` is data with a small accessor.
LINES = (
    {"errors"},
    {"files", "reading", "jit", "memory", "nearest", "pace", "threads", "provenance", "validation"},
    {"checkpoints", "kernel_cache", "parallel", "documents", "request"},
    {"models"},
    {"spatial"},
    {"geometry"},
    {"physics"},
    {"rendering"},
    {"capture", "masks"},
    {"station"},
    {"scene"},
    {"twin"},
    {"cousins"},
    {"tasks"},
    {"identification"},
    {"learning"},
    {"control"},
    {"report"},
    {"systems"},
    {"experiments"},
    {"paper"},
    {"demo", "guide"},
    {"cli"},
)
# The same inside systems, whose folders are lines of their own.
SYSTEMS = (
    {"ports"},
    {"sampling", "cameras", "sdf"},
    {"scenario"},
    {"pusher"},
    {"engines"},
    {"view"},
    {"station", "arm"},
    {"envs", "runs"},
    {"mpc", "crosscheck"},
    {"control"},
)
RANK = {name: rank for rank, line in enumerate(LINES) for name in line}
SYSTEMS_RANK = {name: rank for rank, line in enumerate(SYSTEMS) for name in line}
# The core is a library of its own: nothing in it may count on the models or the Drake systems; twin and
# learning take from the models where twins and bundles that ship are.
ONLY_IMPORTED_BY = {
    "models": {"twin", "learning", "systems", "experiments", "paper", "demo", "cli"},
    "systems": {"experiments", "paper", "demo", "cli"},
}
MOST_MODULES = 25  # in a folder
WITHOUT_DRAKE = {name for line in LINES[: LINES.index({"report"}) + 1] for name in line}


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
        inside = parts[1] if here == "systems" else "__init__"
        if inside != "__init__" and inside not in SYSTEMS_RANK:
            found.append(f"{path}: systems.{inside} has no line in the layout")
            continue
        for name in imported(parts, path):
            package, _, rest = name.partition(".")
            there, *deeper = rest.split(".")
            if package == "pydrake" and (here in WITHOUT_DRAKE or parts[:2] == ("paper", "baselines")):
                found.append(f"{path}: {here} imports pydrake")
            if package != "pinwm_drake" or there not in RANK:
                continue
            if there == here == "systems" and inside != "__init__" and deeper and deeper[0] in SYSTEMS_RANK:
                rank, other = SYSTEMS_RANK[inside], SYSTEMS_RANK[deeper[0]]
                if other > rank or (other == rank and deeper[0] != inside):
                    found.append(f"{path}: systems.{inside} imports systems.{deeper[0]}, which does not stand above it")
            if there == here:
                continue
            if RANK[there] >= RANK[here]:
                found.append(f"{path}: {here} imports {there}, which does not stand above it")
            if here not in ONLY_IMPORTED_BY.get(there, {here}):
                found.append(f"{path}: {here} imports {there}, kept for {sorted(ONLY_IMPORTED_BY[there])}")
    return found


def circles(root: Path) -> list[list[str]]:
    """Modules that import each other, directly or round about; imports inside functions count too."""
    files = {".".join(part for part in parts if part != "__init__"): (parts, path) for parts, path in modules(root)}
    graph: dict[str, set[str]] = {}
    for name, (parts, path) in files.items():
        graph[name] = set()
        for full in imported(parts, path):
            package, _, rest = full.partition(".")
            while package == "pinwm_drake" and rest not in files and rest:
                rest = rest.rpartition(".")[0]  # a name in a module
            if package == "pinwm_drake" and rest in files and rest != name:
                graph[name].add(rest)
    reached = {name: _reach(graph, name) for name in graph}
    found = {frozenset(other for other in reached[name] if name in reached[other]) for name in graph}
    return sorted(sorted(circle) for circle in found if circle)


def _reach(graph: dict[str, set[str]], name: str) -> set[str]:
    """All that a module imports, directly or round about; itself only where it is in a circle."""
    found: set[str] = set()
    left = list(graph[name])
    while left:
        one = left.pop()
        if one not in found:
            found.add(one)
            left += graph[one]
    return found


def test_imports_go_only_upwards():
    assert offences(ROOT) == []
    assert len(list(modules(ROOT))) > 10


def test_no_modules_import_each_other():
    assert circles(ROOT) == []


def test_a_circle_is_found(tmp_path):
    texts = {"a": "from pinwm_drake.twin.b import x", "b": "def f():\n    import pinwm_drake.twin.c", "c": ""}
    (tmp_path / "pinwm_drake/twin").mkdir(parents=True)
    for name, text in texts.items():
        (tmp_path / f"pinwm_drake/twin/{name}.py").write_text(text)
    assert circles(tmp_path) == []
    (tmp_path / "pinwm_drake/twin/c.py").write_text("from pinwm_drake.twin import a")
    assert circles(tmp_path) == [["twin.a", "twin.b", "twin.c"]]


def test_no_folder_is_a_drawer():
    paths = [*(path for _, path in modules(ROOT)), *(ROOT / "benchmarks").rglob("*.py")]
    folders = Counter(path.parent for path in paths if path.name != "__init__.py")
    assert {folder: count for folder, count in folders.items() if count > MOST_MODULES} == {}


@pytest.mark.parametrize(
    ("file", "line", "reason"),
    [
        (
            "pinwm_drake/spatial/a.py",
            "from pinwm_drake.physics.model import Model",
            "physics, which does not stand above",
        ),
        ("pinwm_drake/spatial/a.py", "def f():\n    import pinwm_drake.cli.app", "cli, which does not stand above"),
        ("pinwm_drake/spatial/a.py", "from .. import geometry", "geometry, which does not stand above"),
        ("pinwm_drake/spatial/__init__.py", "from ..report import figures", "report, which does not stand above"),
        ("pinwm_drake/report/a.py", "from pinwm_drake.models import model_path", "kept for"),
        ("pinwm_drake/physics/a.py", "from pydrake.math import RotationMatrix", "imports pydrake"),
        ("pinwm_drake/utils.py", "", "no line in the layout"),
        ("pinwm_drake/tasks/a.py", "from pydrake.math import RigidTransform", "imports pydrake"),
        ("systems/utils/a.py", "", "no line in the layout"),
        ("systems/scenario/a.py", "from pinwm_drake.systems.pusher.limits import shortened", "does not stand above"),
        ("systems/sdf/a.py", "from pinwm_drake.systems.cameras import surfel_camera", "does not stand above"),
        ("models/__init__.py", "import pinwm_drake.spatial", "spatial, which does not stand above"),
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
