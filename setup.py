"""Finds the packages. Everything else about the distribution stands in pyproject.toml.

`systems` and `models` are top-level folders that install as pinwm_drake.systems and pinwm_drake.models; a
static list in pyproject.toml could not leave out a folder that a tree does not have.
"""

from pathlib import Path

from setuptools import find_namespace_packages, find_packages, setup

packages = find_packages(include=["pinwm_drake", "pinwm_drake.*"])
package_dir = {}
for folder in ("systems", "models"):
    if Path(folder, "__init__.py").is_file():
        # Folders that hold only data count too.
        inside = find_namespace_packages(folder, exclude=["*__pycache__*"])
        packages += [f"pinwm_drake.{folder}", *(f"pinwm_drake.{folder}.{name}" for name in inside)]
        package_dir[f"pinwm_drake.{folder}"] = folder

setup(packages=packages, package_dir=package_dir)
