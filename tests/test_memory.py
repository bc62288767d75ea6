# SPDX-License-Identifier: MIT
import psutil
import pytest

from pinwm_drake.memory import memory

MIB = 2**20


@pytest.fixture
def groups(tmp_path):
    """File of a process in a group of another one, of either version."""
    file = tmp_path / "groups"
    file.write_text("4:memory:/job/step\n0::/job/step\n")
    return file


def limit(folder, most, used, cached=0, version=2):
    folder.mkdir(parents=True, exist_ok=True)
    names = ("memory.max", "memory.current") if version == 2 else ("memory.limit_in_bytes", "memory.usage_in_bytes")
    for name, amount in zip(names, (most, used), strict=True):
        (folder / name).write_text(f"{amount}\n")
    (folder / "memory.stat").write_text(f"anon 5\n{'' if version == 2 else 'total_'}inactive_file {cached}\n")


def test_without_a_limit_memory_is_the_machine_s(tmp_path, groups):
    limit(tmp_path / "job", "max", 0)
    machine = psutil.virtual_memory()
    total, free = memory(tmp_path, groups)
    assert total == machine.total
    assert free == pytest.approx(machine.available, rel=0.2)


@pytest.mark.parametrize(("version", "folder"), [(2, ""), (1, "memory")])
@pytest.mark.parametrize("group", ["", "job", "job/step"])
def test_a_control_group_and_its_parents_limit_the_memory(tmp_path, groups, version, folder, group):
    limit(tmp_path / folder / group, 300 * MIB, 200 * MIB, version=version)
    assert memory(tmp_path, groups) == (300 * MIB, 100 * MIB)


@pytest.mark.parametrize(("version", "folder"), [(2, ""), (1, "memory")])
def test_files_that_the_system_may_drop_are_free(tmp_path, groups, version, folder):
    limit(tmp_path / folder / "job", 300 * MIB, 200 * MIB, 50 * MIB, version)
    assert memory(tmp_path, groups) == (300 * MIB, 150 * MIB)


def test_a_group_of_other_processes_does_not_count(tmp_path, groups):
    limit(tmp_path / "other", 300 * MIB, 200 * MIB)
    assert memory(tmp_path, groups)[0] == psutil.virtual_memory().total
