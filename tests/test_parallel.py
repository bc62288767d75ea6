# SPDX-License-Identifier: MIT
import importlib.util
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import psutil
import pytest

from pinwm_drake.errors import InputError, ParameterError, PinwmError, SolverError
from pinwm_drake.parallel import EXECUTORS, Executor
from tests.parallel_work import Folder, fail, gate, half, logged, pid, smaller, sum_of_needed, threads, torch_threads

ROOT = Path(__file__).parents[1]
PATIENCE = 120.0  # s, for what has to happen; most of it comes at once


@pytest.fixture(params=EXECUTORS)
def name(request) -> str:
    if request.param == "ray":
        pytest.importorskip("ray")
    return request.param


@pytest.fixture
def store(tmp_path) -> Folder:
    return Folder(tmp_path)


def wait_for(condition: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


def begun(folder: Path, item: object = "*") -> list[int]:
    """Processes that have begun an item."""
    return [int(path.suffix[1:]) for path in folder.glob(f"begun.{item}.*")]


def running(pids: list[int]) -> list[int]:
    """Those that have not ended; what a killed process leaves may be waited for by no one."""
    found = []
    for one in pids:
        try:
            if psutil.Process(one).status() != psutil.STATUS_ZOMBIE:
                found.append(one)
        except psutil.NoSuchProcess:
            pass
    return found


@pytest.fixture
def driver(name, tmp_path) -> Iterator[subprocess.Popen]:
    """Another process, two of whose six items are done and two of which wait."""
    command = [sys.executable, "-m", "tests.parallel_work", name, str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, cwd=ROOT, env=environment) as process:
        try:
            wait_for(lambda: len(begun(tmp_path, "[2-5]")) == 2 or process.poll() is not None, "items begin")
            yield process
        finally:
            (tmp_path / "go").touch()
            process.kill()


def test_results_come_in_the_order_of_the_items_and_are_told_of_when_done(name, tmp_path):
    told = []

    def tell(item, result):
        told.append((item, result))
        (tmp_path / "go").touch()  # the first item waits until another one is told of

    results = Executor(name, 2).map(partial(gate, tmp_path), [2, 0, 1], on_result=tell)
    assert results == [1.0, 0.0, 0.5]
    assert sorted(told) == [(item, item / 2) for item in range(3)]
    assert told[0] == (0, 0.0)


def test_the_number_of_workers_is_that_of_the_processes(name):
    pids = set(Executor(name, 2).map(pid, range(12)))
    assert len(pids) == 2
    assert os.getpid() not in pids
    assert set(Executor(workers=1).map(pid, range(2))) == {os.getpid()}
    assert Executor(name, 2).map(half, []) == []


def test_processes_of_the_default_are_no_more_than_memory_has_room_for(monkeypatch):
    monkeypatch.setattr("pinwm_drake.parallel.available", lambda: 4)
    monkeypatch.setattr("pinwm_drake.parallel.memory", lambda: (1 << 30, 700 << 20))
    assert Executor().number(9) == 1
    assert Executor(workers=2).number(9) == 2
    with pytest.warns(UserWarning, match="--workers: 1 in place of 4; free memory has room for 1"):
        assert Executor().map(half, [2, 4, 6, 8]) == [1, 2, 3, 4]
    with pytest.warns(UserWarning, match="--workers: got 2; free memory has room for 1"):
        assert Executor(workers=2).map(half, [2, 4]) == [1, 2]
    monkeypatch.setattr("pinwm_drake.parallel.memory", lambda: (0.0, 0.0))
    assert Executor().number(9) == 4


def test_results_of_a_store_are_not_computed_again(name, store):
    function, told = partial(logged, store.path), []
    assert Executor(name, 2).map(function, [3, 1], store=store) == [1.5, 0.5]
    (store.path / "log").unlink()
    store.write(1, 7.0)
    results = Executor(name, 2).map(
        function, [1, 2, 3, 4], store=store, on_result=lambda item, result: told.append(item)
    )
    assert results == [7.0, 1.0, 1.5, 2.0]
    assert sorted((store.path / "log").read_text().split()) == ["2", "4"]
    assert told[:2] == [1, 3]
    assert sorted(told) == [1, 2, 3, 4]
    assert Executor(workers=1).map(function, [1, 5], store=store) == [7.0, 2.5]
    assert store.items() == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("workers", [1, 2])
def test_an_item_begins_when_those_that_it_needs_are_done(name, workers, store):
    store.write(0, 10.0)
    function = partial(sum_of_needed, store)
    results = Executor(name, workers).map(function, [5, 4, 3, 2, 1, 0], needs=smaller, store=store)
    assert results[::-1] == [10.0, 11.0, 22.0, 34.0, 57.0, 92.0]


@pytest.mark.parametrize("workers", [1, 2])
def test_errors_come_back_as_they_are(name, workers, store):
    executor = Executor(name, workers)
    with pytest.raises(InputError, match=r"^a\.csv, row 3: got x; allowed: finite$") as raised:
        executor.map(partial(fail, "input"), range(3), store=store)
    assert (raised.value.path, raised.value.row, raised.value.allowed) == ("a.csv", 3, "finite")
    with pytest.raises(SolverError, match=r"^none$") as solver:
        executor.map(partial(fail, "solver"), range(3))
    assert solver.value.worlds == (1, 2)
    with pytest.raises(ValueError, match="no error of the family"):
        executor.map(partial(fail, "other"), range(3))


@pytest.mark.parametrize(("name", "workers"), [("joblib", 1), ("joblib", 2), ("ray", 2)], indirect=["name"])
def test_what_does_not_need_an_item_that_failed_is_done_before_its_error_is_raised(name, workers, store):
    executor, told = Executor(name, workers), []
    with pytest.raises(InputError, match=r"^a\.csv, row 3: got x; allowed: finite$"):
        executor.map(
            partial(fail, "input"),
            range(6),
            needs=lambda k: [1] if k == 4 else [],
            store=store,
            on_result=lambda item, result: told.append(item),
            keep_going=True,
        )
    assert sorted(told) == store.items() == [0, 2, 3, 5]


def test_several_errors_are_all_told_and_one_of_another_family_ends_the_call():
    executor = Executor(workers=1)
    with pytest.raises(PinwmError, match=r"^none; none$"):
        executor.map(partial(fail, "solver"), [1, 0, 1], keep_going=True)
    with pytest.raises(ValueError, match="no error of the family"):
        executor.map(partial(fail, "other"), range(3), keep_going=True)


def test_a_worker_takes_what_another_run_made_after_it_began(store):
    def other(item, result):
        store.write(3, 7.0)

    function = partial(logged, store.path)
    assert Executor(workers=1).map(function, [1, 3], store=store, on_result=other) == [0.5, 7.0]
    assert (store.path / "log").read_text().split() == ["1"]


def test_a_worker_has_one_thread(name, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    assert Executor(name, 2).map(threads, range(2)) == [(1, 1, 1)] * 2
    before = torch_threads(0)
    assert Executor(workers=1).map(torch_threads, range(2)) == [1, 1]
    assert torch_threads(0) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "dask"}, "executor: got 'dask'; allowed: joblib, ray"),
        ({"workers": 0}, "--workers: got 0; allowed: 1 or more"),
        ({"workers": -1, "option": "--processes"}, "--processes: got -1; allowed: 1 or more"),
    ],
)
def test_values_out_of_range_are_refused(arguments, message):
    with pytest.raises(ParameterError, match=message):
        Executor(**arguments)


def test_ray_that_is_not_installed_is_refused(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ParameterError, match=r"^executor: ray is not installed; run: pip install ray "):
        Executor("ray")


def test_a_worker_that_is_killed_is_told_of_and_a_second_call_does_the_rest(store):
    def kill(item, result):
        if item == 1:
            wait_for(lambda: len(begun(store.path, "[2-5]")) == 2, "items begin")
            os.kill(begun(store.path, 2)[0], signal.SIGKILL)

    function, items = partial(gate, store.path), range(6)
    with pytest.raises(ParameterError, match=r"^--workers: one of 2 processes ended by itself.*--resume, with fewer"):
        Executor(workers=2).map(function, items, store=store, on_result=kill)
    assert store.items() == [0, 1]
    assert running(begun(store.path)) == []
    (store.path / "go").touch()
    for mark in store.path.glob("begun.*"):
        mark.unlink()
    assert Executor(workers=2).map(function, items, store=store) == [item / 2 for item in items]
    assert begun(store.path, "[01]") == []


def test_without_a_store_a_killed_worker_is_not_to_be_resumed(tmp_path):
    def kill(item, result):
        (tmp_path / "go").touch()
        with suppress(ProcessLookupError):  # a second result may come before the death of the first worker is seen
            os.kill(begun(tmp_path)[0], signal.SIGKILL)

    message = r"^--processes: one of 2 .* for want of memory; start again, with fewer --processes$"
    with pytest.raises(ParameterError, match=message):
        Executor(workers=2, option="--processes").map(partial(gate, tmp_path), range(40), on_result=kill)


def test_ray_gives_the_work_of_a_killed_worker_to_another(store):
    pytest.importorskip("ray")
    told = []

    def kill(item, result):
        told.append(item)
        if len(told) == 2:  # a worker is given no more while a result of it is not taken
            wait_for(lambda: len(begun(store.path, "[2-5]")) == 2, "items begin")
            (first,) = begun(store.path, 2)
            os.kill(first, signal.SIGKILL)
            wait_for(lambda: len(begun(store.path, 2)) == 2, "the item begins again")
            (store.path / "go").touch()

    results = Executor("ray", 2).map(partial(gate, store.path), range(6), store=store, on_result=kill)
    assert results == [item / 2 for item in range(6)]
    assert len(begun(store.path)) == 7


def test_when_the_driver_is_killed_its_workers_end_and_a_second_run_does_the_rest(name, store, driver):
    family = [process.pid for process in psutil.Process(driver.pid).children(recursive=True)]
    assert set(begun(store.path)) <= set(family)
    driver.kill()
    driver.wait()
    wait_for(lambda: not running(family), "processes outlive the driver")
    assert store.items() == [0, 1]
    (store.path / "go").touch()
    for mark in store.path.glob("begun.*"):
        mark.unlink()
    told = []
    results = Executor(name, 2).map(
        partial(gate, store.path), range(6), store=store, on_result=lambda item, result: told.append(item)
    )
    assert results == [item / 2 for item in range(6)]
    assert told[:2] == [0, 1]
    assert len(begun(store.path)) == 4
    assert begun(store.path, "[01]") == []


def test_an_interrupt_ends_the_workers_at_once(store, driver):
    family = [process.pid for process in psutil.Process(driver.pid).children(recursive=True)]
    driver.send_signal(signal.SIGINT)
    assert driver.wait(PATIENCE) == 0
    assert (store.path / "interrupted").exists()
    wait_for(lambda: not running(family), "processes outlive the driver")
    assert store.items() == [0, 1]


def test_no_worker_outlives_its_call(name):
    pids = set(Executor(name, 2).map(pid, range(6)))
    wait_for(lambda: not running(list(pids)), "workers outlive their call")
