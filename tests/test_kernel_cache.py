# SPDX-License-Identifier: MIT
from types import SimpleNamespace

import pytest

from pinwm_drake import jit
from pinwm_drake.kernel_cache import COMPILING, announce_compiling, kernel_cache


@pytest.fixture
def entries(tmp_path, monkeypatch):
    """Two entry points whose cache is empty."""

    def entry(name):
        function = SimpleNamespace(__module__="pinwm_drake.physics.kernels.rollout", __name__=name)
        return type("Entry", (), {"py_func": function, "stats": SimpleNamespace(cache_path=str(tmp_path / "cache"))})()

    monkeypatch.setattr(jit, "entries", [entry("forward"), entry("backward")])
    return tmp_path / "cache"


def test_what_is_compiled_is_counted(entries):
    found = kernel_cache()
    assert (found.compiled, found.entries, found.writable, found.folders) == (0, 2, True, (entries,))
    entries.mkdir()
    (entries / "rollout.forward-12.py311.nbi").write_text("")
    (entries / "rollout.forward-12.py311.1.nbc").write_text("")
    assert kernel_cache().compiled == 1


def test_an_empty_cache_is_announced(entries, monkeypatch, caplog):
    monkeypatch.delenv("PINWM_THREADS", raising=False)
    monkeypatch.setattr(jit, "announcer", jit._Announcer())
    announce_compiling()
    announce_compiling()
    assert caplog.messages == [COMPILING]
    entries.mkdir()
    for name in ("forward", "backward"):
        (entries / f"rollout.{name}-12.py311.nbi").write_text("")
    monkeypatch.setattr(jit, "announcer", jit._Announcer())
    announce_compiling()
    assert len(caplog.messages) == 1
