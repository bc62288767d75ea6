# SPDX-License-Identifier: MIT
import time
from collections import Counter
from pathlib import Path

import psutil
import pytest

from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.run import reproduce
from pinwm_drake.paper.reproduce.tables import Line, Table
from pinwm_drake.parallel import Executor
from tests.paper.reproduce.gated import Gated

ray = pytest.importorskip("ray")

PATIENCE = 120.0  # s
# The first two are made at once; then two wait, one on each machine, and two for these; the last one needs them all.
FIRST = (Gated("0"), Gated("1"))
LATER = tuple(Gated(str(k), waits=True) for k in range(2, 6))
SUM = Gated("sum", needs=(*FIRST, *LATER))
# A machine that does not answer is dead after a second, and not after half a minute.
WATCHFUL = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 200, "health_check_failure_threshold": 5}


@pytest.fixture
def cluster(monkeypatch):
    """Two raylets, each as of a machine of one core; this process is connected to the first one."""
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    cluster = Cluster(initialize_head=True, head_node_args={"include_dashboard": False, "_system_config": WATCHFUL})
    try:
        cluster.add_node()
        ray.init(cluster.address, log_to_driver=False, logging_level="ERROR")
        yield cluster
    finally:
        ray.shutdown()
        cluster.shutdown()


def wait_for(condition, what):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


def begun(root: Path) -> list[tuple[str, int]]:
    """Cells that have begun, each with its process."""
    return [(path.name.split(".")[1], int(path.name.split(".")[2])) for path in root.glob("begun.*")]


def waiting(root: Path) -> list[tuple[str, int]]:
    """Those of them that wait."""
    return [one for one in begun(root) if one[0] in {cell.name for cell in LATER}]


def of_machine(machine) -> set[int]:
    """Processes of a machine's raylet."""
    raylet = psutil.Process(machine.all_processes["raylet"][0].process.pid)
    return {one.pid for one in raylet.children(recursive=True)}


def runs(pid: int) -> bool:
    """Whether a process has not ended; what a killed one leaves may be waited for by no one."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def run(root: Path, on_cell) -> None:
    """Makes the cells, as a command does, whose folder is named from where it stands."""
    table = Table(
        "gated", "Gated", ("name",), lambda request: [Line((), [SUM], ())], lambda cells, results: [], "Gated."
    )
    reproduce([table], ReproduceRequest(), root, executor=Executor("ray", workers=2), on_cell=on_cell)


def test_cells_of_a_machine_that_is_killed_are_made_by_the_other_one_and_none_twice(cluster, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path.parent)  # the raylets are elsewhere
    told, lost, root = [], [], Path(tmp_path.name)

    def kill(cell, done):
        told.append(cell.name)
        if len(told) != len(FIRST):
            return
        wait_for(lambda: len(waiting(tmp_path)) == 2, "a cell begins on each machine")
        (machine,) = cluster.worker_nodes
        theirs = of_machine(machine)
        lost.extend(one for one in waiting(tmp_path) if one[1] in theirs)
        cluster.remove_node(machine, allow_graceful=False)  # SIGKILL
        # Or two would write to the folder of a cell that begins anew.
        wait_for(lambda: not any(runs(pid) for _, pid in lost), "a worker outlives its machine")
        (tmp_path / "go").touch()

    run(root, kill)
    assert sorted(told) == ["0", "1", "2", "3", "4", "5", "sum"]
    ((name, pid),) = lost
    counts = Counter(one for one, _ in begun(tmp_path))
    assert counts == {**dict.fromkeys(told, 1), name: 2}
    made = {}
    run(root, lambda cell, done: made.update({cell.name: done["result"]}))
    assert Counter(one for one, _ in begun(tmp_path)) == counts
    assert made["sum"]["sum"] == 7
    assert made[name]["process"] != pid
