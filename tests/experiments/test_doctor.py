# SPDX-License-Identifier: MIT
import os
import socket
from importlib import metadata

import pytest

from pinwm_drake.experiments import doctor
from pinwm_drake.experiments.doctor import (
    check_cores,
    check_disk,
    check_kernels,
    check_memory,
    check_meshcat,
    check_rendering,
    check_threads,
    check_versions,
    cpu_quota,
    examine,
)


def test_every_check_has_a_finding(tmp_path, monkeypatch):
    def fails():
        raise ImportError("libfoo.so: cannot open shared object file\nmore")

    monkeypatch.setattr(doctor, "check_torch", fails)
    monkeypatch.setattr(doctor, "check_rendering", lambda: doctor.Finding("rendering", "ok", "not looked at here"))
    found = {one.name: one for one in examine(tmp_path)}
    names = ["versions", "torch", "cores", "threads", "memory", "kernels", "rendering", "disk", "Meshcat"]
    assert list(found) == names
    assert found["torch"].status == "broken"
    assert found["torch"].found == "ImportError: libfoo.so: cannot open shared object file"
    assert all(one.advice for one in found.values() if one.status != "ok")


def test_a_version_that_is_not_allowed_is_broken(monkeypatch):
    assert "numba" in check_versions().found
    wanted = ["numba>=999", "torch>=2", "no-such-library>=1", 'other>=1; extra == "dev"']
    monkeypatch.setattr(metadata, "requires", lambda name: wanted)
    found = check_versions()
    assert found.status == "broken"
    assert found.advice == "pip install 'numba>=999' 'no-such-library>=1'"


def test_the_quota_of_a_container_is_read(tmp_path):
    assert cpu_quota(tmp_path) is None
    (tmp_path / "cpu").mkdir()
    (tmp_path / "cpu/cpu.cfs_quota_us").write_text("-1\n")
    assert cpu_quota(tmp_path) is None
    (tmp_path / "cpu/cpu.cfs_quota_us").write_text("150000\n")
    (tmp_path / "cpu/cpu.cfs_period_us").write_text("100000\n")
    assert cpu_quota(tmp_path) == 1.5
    (tmp_path / "cpu.max").write_text("max 100000\n")
    assert cpu_quota(tmp_path) is None
    (tmp_path / "cpu.max").write_text("200000 100000\n")
    assert cpu_quota(tmp_path) == 2.0


@pytest.mark.parametrize(
    ("cores", "quota", "load", "status", "advice"),
    [
        (4, None, 0.1, "ok", ""),
        (4, 2.0, 0.1, "slow", "set PINWM_THREADS=2"),
        (4, None, 9.0, "slow", "other processes"),
        (1, None, 0.1, "slow", "two cores"),
    ],
)
def test_cores_that_are_few_shared_or_busy_are_slow(monkeypatch, cores, quota, load, status, advice):
    monkeypatch.setattr(doctor, "_affinity", lambda: cores)
    monkeypatch.setattr(doctor, "available", lambda: cores)
    monkeypatch.setattr(doctor, "cpu_quota", lambda: quota)
    monkeypatch.setattr(os, "getloadavg", lambda: (load, load, load))
    found = check_cores()
    assert found.status == status
    assert found.advice.startswith(advice)


def test_settings_of_threads_that_cost_time_are_slow(monkeypatch):
    monkeypatch.setattr(doctor, "_affinity", lambda: 4)
    monkeypatch.setattr(doctor, "available", lambda: 4)
    monkeypatch.setenv("OMP_NUM_THREADS", "16")
    assert check_threads().advice.startswith("set OMP_NUM_THREADS=4")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert check_threads().status == "ok"
    monkeypatch.setattr(doctor, "available", lambda: 1)
    assert "unset PINWM_THREADS" in check_threads().advice


def test_little_memory_is_slow(monkeypatch):
    monkeypatch.setattr(doctor, "memory", lambda: (3 << 30, 1 << 30))
    assert check_memory().status == "slow"
    assert check_memory().found == "1.0 of 3.0 GiB free"


def test_kernels_that_are_not_compiled_are_slow(monkeypatch, tmp_path):
    from pinwm_drake import kernel_cache

    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    for compiled, writable, status, words in (
        (25, False, "ok", ""),
        (0, True, "slow", "one to three minutes of CPU"),
        (0, False, "slow", "set NUMBA_CACHE_DIR"),
    ):
        state = kernel_cache.KernelCache((tmp_path,), compiled, 25, writable)
        monkeypatch.setattr(kernel_cache, "kernel_cache", lambda state=state: state)
        found = check_kernels()
        assert found.status == status
        assert words in found.advice
        assert str(tmp_path) in found.found
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert check_kernels().advice == "unset NUMBA_DISABLE_JIT"


def test_a_picture_is_drawn_in_a_process_of_its_own(monkeypatch):
    assert check_rendering().status == "ok"
    monkeypatch.setattr(doctor, "_PATIENCE", 1e-3)
    assert check_rendering().status == "broken"


def test_a_folder_that_is_not_there_is_on_the_disk_of_its_parent(tmp_path, monkeypatch):
    assert check_disk(tmp_path / "not/there").status == "ok"
    monkeypatch.setattr(doctor, "_LEAST_DISK", 1 << 60)
    assert str(tmp_path) in check_disk(tmp_path).advice
    monkeypatch.setattr(os, "access", lambda *arguments: False)
    assert check_disk(tmp_path).status == "broken"


def test_a_taken_port_is_passed_over(monkeypatch):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        monkeypatch.setattr(doctor, "_FIRST_PORT", port)
        monkeypatch.setattr(doctor, "_PORTS", 1)
        assert check_meshcat().status == "slow"
        monkeypatch.setattr(doctor, "_PORTS", 50)
        assert check_meshcat().status == "ok"
