# SPDX-License-Identifier: MIT
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from pinwm_drake.errors import InputError, ParameterError, PinwmError
from pinwm_drake.paper.reproduce import paper, policies
from pinwm_drake.paper.reproduce.policies import PolicyCell
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.run import (
    CellError,
    listed,
    markdown,
    plan,
    read_results,
    reproduce,
    seeds_of,
    tables_of,
    write_report,
)
from pinwm_drake.paper.reproduce.systems import SYSTEMS
from pinwm_drake.paper.reproduce.tables import NONE, Line, Table
from pinwm_drake.parallel import Executor

RESULTS = Path(__file__).resolve().parents[3] / "docs/results"
OPTIONS = {"tasks": ("push",), "methods": ("pin-wm", "random-actions"), "episodes": 2, "quick": True}
REQUEST = ReproduceRequest(**OPTIONS)
KEYS = [
    ["captures/push/seed-0", "evaluations/push/random-actions/seed-0"],
    ["surfels/push/seed-0"],
    ["twins/pin-wm/push/seed-0"],
    ["policies/push/pin-wm/seed-0"],
    ["evaluations/push/pin-wm/seed-0"],
]


def keys(planned):
    return [[cell.key for cell in wave] for wave in planned.waves]


def test_the_plan_names_every_cell_once_and_what_is_left(tmp_path: Path):
    planned = plan(tables_of(["policies"]), REQUEST, tmp_path)
    assert keys(planned) == KEYS
    assert planned.done == [0] * 5
    assert 0.0 < planned.hours < 0.2
    whole = plan(tables_of(["all"]), ReproduceRequest(seeds=2), tmp_path)
    names = [key for wave in keys(whole) for key in wave]
    assert len(names) == len(set(names))
    assert {f"policies/{task}/domain-rand/seed-1" for task in ("push", "flip")} <= set(names)
    assert whole.hours > 20.0
    histories = {cell.system: cell.history for wave in whole.waves for cell in wave if isinstance(cell, PolicyCell)}
    assert {name for name, history in histories.items() if history == 4} == {
        "domain-rand", "domain-rand-2", "domain-rand-4",
    }  # fmt: skip
    assert set(histories.values()) == {0, 4}


def test_parameters_are_identified_one_at_a_time_by_every_system_that_has_them(tmp_path: Path):
    (table,), request = tables_of(["parameters"]), ReproduceRequest(tasks=("push",))
    rows = table.rows(request, read_results([table], request, tmp_path))
    assert [(row[1], row[2]) for row in rows if row[2] != "asid-generous"] == [
        ("friction_floor", "pin-wm"),
        ("friction_floor", "asid"),
        ("friction_floor, beside all that is looked for by default", "2d-physics"),
        ("mass", "pin-wm"),
        ("mass", "asid"),
        ("restitution_floor", "pin-wm"),
        ("restitution_floor", "asid"),
        ("mass, with the force on the pusher, beside all that is looked for by default", "pin-wm"),
    ]
    keys = {cell.key for cell in table.cells(request)}
    assert {"twins/asid-mass/push/seed-0", "twins/2d-physics/push/seed-0"} <= keys
    few = {cell.system for cell in table.cells(ReproduceRequest(tasks=("push",), methods=("asid",)))}
    assert few == {"asid"}


def test_what_a_video_tells_is_said_by_the_system_that_asks_it_alone():
    (table,), request = tables_of(["parameters"]), ReproduceRequest(tasks=("push",))
    theta = ("friction_floor", "mass", "restitution_floor")
    estimates = {name: {"value": 0.1, "interval": None, "identifiable": False} for name in theta}
    rows = table.rows(request, {cell: {"result": {"estimates": estimates}} for cell in table.cells(request)})
    told = {(row[2], row[7]) for row in rows}
    assert told == {("pin-wm", "no"), ("asid", "not told"), ("asid-generous", "not told"), ("2d-physics", "not told")}


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("policies", paper.POLICIES),
        ("stand-in", paper.ROBOT),
        ("tasks", paper.TASKS),
        ("one-step", paper.ONE_STEP),
        ("geometry-noise", paper.NOISE),
        ("parameters", paper.PARAMETERS),
    ],
)
def test_each_figure_of_the_paper_stands_in_a_row_of_its_table(name, known):
    (table,) = tables_of([name])
    rows = table.rows(ReproduceRequest(), {})
    assert {len(row) for row in rows} == {len(table.header)}
    told = [row[-1] for row in rows if row[-1] != NONE]
    assert sorted(set(told)) == sorted(set(known.values()))
    assert len(told) >= len(known)


def test_the_stand_in_has_captures_twins_policies_and_evaluations_of_its_own(tmp_path: Path):
    waves = plan(tables_of(["stand-in"]), ReproduceRequest(tasks=("push",), methods=("pin-wm", "mpc")), tmp_path).waves
    cells = {cell.key: cell for wave in waves for cell in wave}
    tried = {key: cell for key, cell in cells.items() if key.startswith("stand-in/")}
    assert set(tried) == {f"stand-in/push/{name}/seed-0" for name in ("pin-wm", "mpc")}
    assert {cell.episodes for cell in tried.values()} == {20}
    assert set(cells) - set(tried) == {
        "captures/push-stand-in/seed-0",
        "surfels/push-stand-in/seed-0",
        "twins/pin-wm/push-stand-in/seed-0",
        "policies/push-stand-in/pin-wm/seed-0",
    }


@pytest.mark.parametrize(
    ("name", "stand_in", "filmed"), [("pin-wm", True, True), ("asid", True, False), ("pin-wm", False, False)]
)
def test_pin_wm_alone_learns_from_the_video_where_the_camera_of_a_station_is(
    name, stand_in, filmed, tmp_path, monkeypatch
):
    asked = []
    monkeypatch.setattr(policies, "train", lambda request, **settings: asked.append(request))
    PolicyCell("flip", 0, name, None, stand_in=stand_in).make(tmp_path, print)
    (request,) = asked
    assert request.as_filmed is filmed
    assert (request.mask_error, request.latency) == ((1.0, (0.07, 0.09)) if stand_in else (0.0, None))


@pytest.mark.parametrize("name", ["dreamer-v2", "diffusion-policy"])
def test_what_is_recorded_for_the_stand_in_is_recorded_in_it(name, tmp_path: Path):
    waves = plan(tables_of(["stand-in"]), ReproduceRequest(tasks=("flip",), methods=(name,)), tmp_path).waves
    keys = [cell.key for wave in waves for cell in wave]
    assert all(key.split("/")[1] == "flip-stand-in" for key in keys if not key.startswith("stand-in/"))
    assert len(keys) > 2


@pytest.mark.parametrize("values", [{"tasks": ("juggle",)}, {"methods": ("dreams",)}, {"seeds": 0}, {"draws": 0}])
def test_requests_that_make_no_sense_are_refused(values):
    with pytest.raises(ParameterError):
        ReproduceRequest(**values)


def test_tables_are_known_by_name():
    assert [table.name for table in tables_of(["one-step", "policies", "one-step"])] == ["one-step", "policies"]
    with pytest.raises(ParameterError, match=r"'poems'; allowed: all, policies"):
        tables_of(["poems"])


_SCRIPT = """
from pathlib import Path
from tests.paper.reproduce.test_run import OPTIONS
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.run import reproduce, tables_of
from pinwm_drake.parallel import Executor
reproduce(tables_of(["policies"]), ReproduceRequest(**OPTIONS), Path({root!r}), executor=Executor(workers=1))
"""


@pytest.mark.nightly
def test_a_table_is_made_though_it_was_killed_and_nothing_is_made_twice(tmp_path: Path):
    # In a process that is killed once the twin is there, and so within the training.
    process = subprocess.Popen([sys.executable, "-c", _SCRIPT.format(root=str(tmp_path))])
    twin, deadline = tmp_path / KEYS[2][0] / "done.json", time.monotonic() + 900
    while not twin.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("done.json")}
    assert twin in before
    told, tables = [], tables_of(["policies"])
    run = {"executor": Executor(workers=1), "on_cell": lambda cell, done: told.append(cell.key)}
    reproduce(tables, REQUEST, tmp_path, **run)
    assert sorted(told) == sorted(key for wave in KEYS for key in wave)
    assert all(path.stat().st_mtime_ns == at for path, at in before.items())
    assert plan(tables, REQUEST, tmp_path).done == [2, 1, 1, 1, 1]
    results = read_results(tables, REQUEST, tmp_path)
    assert {cell.system: done["result"]["episodes"] for cell, done in results.items()} == {
        "pin-wm": 2,
        "random-actions": 2,
    }
    path = tmp_path / "new" / "report.md"
    write_report(path, tables, ReproduceRequest(tasks=("push",), episodes=2, quick=True), tmp_path)
    lines = path.read_text().splitlines()
    rows = {line.split(" | ")[1]: line for line in lines if line.startswith("| push")}
    assert list(rows) == list(SYSTEMS)
    assert f"| {REQUEST.max_steps:.1f} | 0 |" in rows["pin-wm"]
    assert "Made with `--quick`" in path.read_text()
    assert "; 2 episodes of each evaluation. Commits " in path.read_text()
    assert "not run" in rows["domain-rand"]
    # Cells of other budgets are not taken for these.
    with pytest.raises(InputError, match=r"other settings \(episodes: 2, and not 3\)"):
        plan(tables, ReproduceRequest(**{**OPTIONS, "episodes": 3}), tmp_path)


@dataclass(frozen=True)
class Toy:
    """A cell that leaves a line, waits for a file or fails."""

    name: str
    needs: tuple["Toy", ...] = ()
    waits: bool = False
    error: str = ""
    hours: float = 0.001

    @property
    def key(self):
        return f"toys/{self.name}"

    def make(self, root, say):
        with (root / "log").open("a") as file:
            file.write(f"{self.name}\n")
        if self.error == "os":
            (root / "surfels.ply").read_text()
        if self.error:
            raise ParameterError(self.error)
        while self.waits and not (root / "go").exists():
            time.sleep(0.01)
        return {"name": self.name}


def toys(*cells):
    return [Table("toys", "Toys", ("name",), lambda request: [Line((), cells, ())], lambda cells, results: [], "Toys.")]


FIRST = Toy("first", waits=True)
LAST = Toy("last", (FIRST,))


def run_toys(root):
    reproduce(toys(LAST), REQUEST, root, executor=Executor(workers=1))


@pytest.mark.nightly
def test_two_runs_that_share_a_folder_make_each_cell_once(tmp_path: Path):
    # Both begin before anything is made.
    pair = [multiprocessing.get_context("spawn").Process(target=run_toys, args=(tmp_path,)) for _ in range(2)]
    for process in pair:
        process.start()
    deadline = time.monotonic() + 120
    while not (tmp_path / "log").exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(3.0)  # the other one comes to it as well, most likely
    (tmp_path / "go").touch()
    for process in pair:
        process.join(120)
    assert [process.exitcode for process in pair] == [0, 0]
    assert (tmp_path / "log").read_text().split() == ["first", "last"]


@pytest.mark.nightly
@pytest.mark.parametrize("workers", [1, 2])
def test_a_cell_that_fails_is_named_and_what_does_not_need_it_is_made(tmp_path: Path, workers):
    wrong, lost = Toy("wrong", error="mass: got -1"), Toy("lost", error="os")
    cells, told = (Toy("after", (wrong,)), Toy("well"), lost, LAST), []
    (tmp_path / "go").touch()

    def run(*tried):
        told.clear()
        executor = Executor(workers=workers)
        reproduce(toys(*tried), REQUEST, tmp_path, executor=executor, on_cell=lambda cell, done: told.append(cell.name))

    with pytest.raises(PinwmError) as raised:
        run(*cells)
    assert sorted(told) == ["first", "last", "well"]
    assert "toys/wrong: mass: got -1" in str(raised.value)
    assert "toys/lost: FileNotFoundError" in str(raised.value)
    assert "surfels.ply" in (tmp_path / "logs" / "toys_lost.txt").read_text()  # a long message loses its middle
    assert "after" not in str(raised.value)
    assert "Traceback" in (tmp_path / "logs" / "toys_lost.txt").read_text()
    with pytest.raises(CellError, match=r"^toys/wrong: mass: got -1 \(log: .*toys_wrong\.txt\)$"):
        run(cells[0], cells[1])
    assert told == ["well"]


def test_a_relative_folder_is_that_of_the_caller(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seen = []
    monkeypatch.setattr(Toy, "make", lambda self, root, say: seen.append(root) or {})
    reproduce(toys(Toy("one")), REQUEST, Path("out"), executor=Executor(workers=1))
    assert seen == [tmp_path / "out"]


def test_the_number_of_seeds_is_that_of_the_folder(tmp_path: Path):
    assert seeds_of(tmp_path) == 1
    for seed in (0, 2):
        folder = tmp_path / f"policies/push/pin-wm/seed-{seed}"
        folder.mkdir(parents=True)
        (folder / "done.json").touch()
    (tmp_path / "policies/push/pin-wm/seed-7").mkdir()
    assert seeds_of(tmp_path) == 3


def test_a_report_of_a_folder_with_nothing_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match="none of the cells of these tables"):
        write_report(tmp_path / "report.md", tables_of(["policies"]), REQUEST, tmp_path / "nowhere")
    assert not (tmp_path / "report.md").exists()


def test_a_task_that_is_named_twice_counts_once_and_systems_of_no_table_are_refused(tmp_path: Path):
    assert ReproduceRequest(tasks=("push", "flip", "push")).tasks == ("push", "flip")
    with pytest.raises(ParameterError, match=r"--methods: got robogsim, none of which is in parameters"):
        plan(tables_of(["parameters"]), ReproduceRequest(methods=("robogsim",)), tmp_path)


def test_the_tables_of_the_documentation_are_those_of_its_cells():
    page, request = (RESULTS / "tables.md").read_text(encoding="utf-8"), ReproduceRequest(seeds=2)
    for table in tables_of(["all"]):
        results = read_results([table], request, RESULTS / "reproduce")
        rows = listed(table.header, table.rows(request, results))
        assert f"## {table.title}\n\n{table.words}\n\n{markdown(table.header, rows)}\n" in page


def test_a_row_has_an_interval_of_each_seed_and_names_the_seeds():
    (table,) = tables_of(["policies"])
    request = ReproduceRequest(tasks=("push",), methods=("random",), seeds=3)
    result = {"success_rate": 0.18, "interval_95": [0.117, 0.267], "steps": {"all": {"mean": 91.2}}}
    done = {cell: {"result": result, "provenance": {"minutes": 59.0}} for cell in table.cells(request) if cell.seed}
    (row,) = table.rows(request, done)
    assert row[3:-1] == ["18 %, 18 %", "11.7 % to 26.7 %, 11.7 % to 26.7 %", "91.2, 91.2", "1, 2", "59, 59"]
