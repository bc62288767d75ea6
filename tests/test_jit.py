# SPDX-License-Identifier: MIT
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest
from packaging.requirements import Requirement

from pinwm_drake import jit
from pinwm_drake.errors import VersionError
from pinwm_drake.jit import NUMBA, forget_stale_kernels, require_numba


def test_another_release_of_numba_is_refused_in_one_line():
    require_numba(f"{NUMBA}.7")
    with pytest.raises(VersionError, match=rf"^numba: got version 0.69.0; allowed: {NUMBA}.*") as refused:
        require_numba("0.69.0")
    assert isinstance(refused.value, ImportError)
    assert "\n" not in str(refused.value)


def test_the_package_asks_for_the_releases_of_numba_that_it_takes():
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    (numba,) = (wanted for wanted in map(Requirement, project["dependencies"]) if wanted.name == "numba")
    for version, takes in ((f"{NUMBA}.0", True), (f"{NUMBA}.9", True), ("0.67.9", False), ("0.69.0", False)):
        assert numba.specifier.contains(version) == takes


def test_cached_kernels_go_when_a_kernel_source_changes(tmp_path):
    (tmp_path / "kernels" / "__pycache__").mkdir(parents=True)
    source = tmp_path / "kernels" / "inner.py"
    source.write_text("from pinwm_drake.jit import kernel  # one\n")
    cached = tmp_path / "kernels" / "__pycache__" / "outer.f-1.py311.nbi"
    cached.write_text("compiled")
    assert forget_stale_kernels(tmp_path)  # no hash yet: nothing is known about the cache
    assert not cached.exists()
    cached.write_text("compiled")
    assert not forget_stale_kernels(tmp_path)
    assert cached.exists()
    (tmp_path / "other.py").write_text("x = 1\n")  # not a kernel
    assert not forget_stale_kernels(tmp_path)
    source.write_text("from pinwm_drake.jit import kernel\nfrom pinwm_drake import (\n    other,\n)\n")
    assert forget_stale_kernels(tmp_path)
    cached.write_text("compiled")
    (tmp_path / "other.py").write_text("x = 2\n")  # a constant of the kernel
    assert forget_stale_kernels(tmp_path)
    assert not cached.exists()
    cached.write_text("compiled")
    source.write_text("from pinwm_drake.jit import kernel  # two\n")
    assert forget_stale_kernels(tmp_path)
    assert not cached.exists()


def test_only_kernels_and_their_cache_count_as_sources_of_kernels():
    package = Path(jit.__file__).parent
    sources = {
        path.relative_to(package).parts[0] for path in package.rglob("*.py") if b"pinwm_drake.jit" in path.read_bytes()
    }
    assert sources <= {"jit.py", "kernel_cache.py", "geometry", "physics", "rendering", "paper"}


def test_compiling_is_announced_once(caplog, monkeypatch):
    monkeypatch.delenv("PINWM_THREADS", raising=False)
    announcer = jit._Announcer()
    for module in ("somebody.else", "pinwm_drake.geometry.entry", "pinwm_drake.physics.kernels.rollout"):
        function = SimpleNamespace(py_func=SimpleNamespace(__module__=module))
        announcer.on_start(SimpleNamespace(data={"dispatcher": function}))
        assert len(caplog.records) == (module != "somebody.else")
    assert caplog.messages == [jit.COMPILING]
    monkeypatch.setenv("PINWM_THREADS", "1")
    jit._Announcer().tell()
    assert len(caplog.records) == 1
