# SPDX-License-Identifier: MIT
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ("pinwm_drake", "models", "systems", "pyproject.toml", "setup.py", "README.md", "LICENSE")


def call(*command: str, cwd: Path, path: Path | None = None) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    if path is not None:
        environment["PYTHONPATH"] = str(path)
    result = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout.strip()


def pip(command: str, *options: str | Path, cwd: Path) -> None:
    call(sys.executable, "-m", "pip", command, "--quiet", "--no-deps", *map(str, options), cwd=cwd)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel built from a copy of the tree, so that no build folder lands in the checkout."""
    scratch = tmp_path_factory.mktemp("wheel")
    source = scratch / "source"
    source.mkdir()
    for name in SOURCES:
        (source / name).symlink_to(ROOT / name)
    pip("wheel", "--no-build-isolation", "--wheel-dir", scratch, source, cwd=scratch)
    (built,) = scratch.glob("pinwm_drake-*.whl")
    return built


@pytest.mark.nightly
def test_source_distribution_builds_the_same_wheel(wheel, tmp_path):
    (tmp_path / "source").mkdir()
    for name in SOURCES:
        (tmp_path / "source" / name).symlink_to(ROOT / name)
    call(sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", str(tmp_path), cwd=tmp_path / "source")
    (archive,) = tmp_path.glob("pinwm_drake-*.tar.gz")
    pip("wheel", "--no-build-isolation", "--wheel-dir", tmp_path, archive, cwd=tmp_path)
    (built,) = tmp_path.glob("pinwm_drake-*.whl")
    assert sorted(zipfile.ZipFile(built).namelist()) == sorted(zipfile.ZipFile(wheel).namelist())


@pytest.fixture(scope="module")
def site(wheel: Path) -> Path:
    """The folder that the wheel is installed in."""
    folder = wheel.parent / "site"
    pip("install", "--no-index", "--no-compile", "--target", folder, wheel, cwd=wheel.parent)
    return folder


def test_installed_wheel_finds_its_models(site, tmp_path):
    code = """
import pinwm_drake, pinwm_drake.models as models
print(pinwm_drake.__file__)
for name in models.model_names():
    print(models.resolve("package://pinwm_models/" + name))
"""
    # -P leaves out the current folder; PYTHONPATH comes before a checkout installed for development.
    package, *files = call(sys.executable, "-P", "-c", code, cwd=tmp_path, path=site).splitlines()
    assert Path(package) == site / "pinwm_drake" / "__init__.py"
    expected = {"package.xml", "t_block/t_block.obj", "cube/cube_visual.obj", "mug/mug_visual.mtl"}
    expected |= {"floor/floor.sdf", "pusher/capsule.sdf", "mug/mug_point.sdf", "mug/pieces/mug_64.obj"}
    assert {Path(file).relative_to(site / "pinwm_drake" / "models").as_posix() for file in files} >= expected


def test_drake_loads_the_models_of_an_installed_wheel(site, tmp_path):
    code = """
from pinwm_drake.models import OBJECT_NAMES, PUSHER_NAMES, model_path, object_model
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

for name in OBJECT_NAMES:
    for path in (object_model(name).sdf_path, object_model(name).point_sdf_path):
        builder = DiagramBuilder()
        plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.001)
        parser = Parser(plant=plant)
        parser.package_map().AddPackageXml(str(model_path("package.xml")))
        for file in (path, model_path("floor/floor.sdf"), model_path("pusher/sphere.sdf")):
            parser.AddModels(str(file))
        plant.Finalize()
        builder.Build()
        print(path, plant.num_bodies())
"""
    # With what it warns of on standard error.
    *lines, last = call(
        sys.executable, "-P", "-c", f"import os; os.dup2(1, 2)\n{code}", cwd=tmp_path, path=site
    ).splitlines()
    assert last.startswith(str(site / "pinwm_drake/models/mug_handle/mug_handle_point.sdf"))
    assert len(lines) == 9


def test_wheel_holds_the_package_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"pinwm_drake"}
    assert not [name for name in names if "__pycache__" in name or name.endswith((".nbi", ".nbc"))]
    folders = {"pinwm_drake": ROOT / "pinwm_drake", "pinwm_drake/systems": ROOT / "systems"}
    checkout = {
        f"{name}/{path.relative_to(folder).as_posix()}"
        for name, folder in folders.items()
        for pattern in ("*.py", "*.html")
        for path in folder.rglob(pattern)
    }
    assert "pinwm_drake/report/base.html" in checkout
    assert checkout <= set(names)
