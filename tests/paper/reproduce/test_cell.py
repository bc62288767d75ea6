# SPDX-License-Identifier: MIT
import json
import multiprocessing
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.paper.reproduce import cell as cells
from pinwm_drake.paper.reproduce.cell import DONE_FILE, CellStore, in_order, made, settings_of


@dataclass(frozen=True)
class Number:
    """A number, the sum of those that it needs and its own."""

    name: str
    own: int
    needs: tuple["Number", ...] = ()
    hours: float = 0.5

    @property
    def key(self):
        return f"numbers/{self.name}"

    def make(self, root, say):
        say(f"adds {self.own}")
        parts = [json.loads((root / one.key / DONE_FILE).read_text())["result"]["sum"] for one in self.needs]
        return {"sum": self.own + sum(parts)}


ONE, TWO = Number("one", 1), Number("two", 2)
BOTH = Number("both", 10, (ONE, TWO))
ALL = Number("all", 100, (BOTH, ONE))


def test_cells_come_after_those_that_they_need_and_once():
    assert in_order([ALL, BOTH]) == [[ONE, TWO], [BOTH], [ALL]]
    assert in_order([]) == []


def test_a_cell_is_made_from_others_and_says_how(tmp_path: Path):
    store, lines = CellStore(tmp_path), []
    for wave in in_order([ALL]):
        for cell in wave:
            assert store.read(cell) is None
            store.write(cell, made(cell, tmp_path, lines.append))
    done = store.read(ALL)
    assert done["result"] == {"sum": 100 + 13 + 1}
    assert done["settings"]["needs"][0]["needs"][1] == {
        "kind": "Number", "name": "two", "own": 2, "needs": [], "hours": 0.5,
    }  # fmt: skip
    assert {"commit", "minutes", "machine", "versions", "time"} <= set(done["provenance"])
    assert lines == ["adds 1", "adds 2", "adds 10", "adds 100"]


@dataclass(frozen=True)
class Waiting(Number):
    """A number that waits for a file, in a folder that it has to be the first to write to."""

    def make(self, root, say):
        folder = root / self.key
        assert not folder.exists() or not any(folder.iterdir())
        (root / "begun").touch()
        while not (root / "go").exists():
            time.sleep(0.01)
        return super().make(root, say)


WAITING, WAITING_AGAIN = Waiting("waiting", 5), Waiting("again", 5)


def waiting_run(root):
    """Makes it in a process of its own, which tells of itself every hundredth of a second."""
    cells._PERIOD = 0.01
    return made(WAITING, root, print)


def test_runs_that_were_killed_count_with_the_one_that_ends(tmp_path: Path, monkeypatch):
    notes = cells.log_path(tmp_path, WAITING, ".runs.json")
    process = multiprocessing.get_context("spawn").Process(target=waiting_run, args=(tmp_path,))
    process.start()
    deadline = time.monotonic() + 120.0
    while not (notes.exists() and json.loads(notes.read_text())[0]["minutes"] > 0.01):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.kill()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    (told,) = json.loads(notes.read_text())
    notes.write_text(json.dumps([told | {"machine": "another"}]))
    # One that fails counts as well.
    with monkeypatch.context() as patch:
        patch.setattr(Waiting, "make", lambda self, root, say: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            made(WAITING, tmp_path, print)
    assert len(json.loads(notes.read_text())) == 2
    (tmp_path / "go").touch()
    done = made(WAITING, tmp_path, print)
    provenance = done["provenance"]
    assert [one["machine"] for one in provenance["runs"]] == ["another", *[provenance["machine"]] * 2]
    assert provenance["minutes"] == pytest.approx(sum(one["minutes"] for one in provenance["runs"]))
    assert provenance["minutes"] > 0.01
    # Until the result is on disk, the notes are.
    assert notes.exists()
    CellStore(tmp_path).write(WAITING, done)
    assert not notes.exists()
    assert "runs" not in made(WAITING_AGAIN, tmp_path, print)["provenance"]


@pytest.mark.parametrize("content", ["3", "[{}]", '["a"]', '[{"minutes": "a", "cpu_minutes": 1}]'])
def test_notes_of_runs_that_are_none_are_refused_before_anything_is_made(tmp_path, content):
    notes = cells.log_path(tmp_path, ONE, ".runs.json")
    notes.parent.mkdir()
    notes.write_text(content)
    with pytest.raises(InputError, match=r"numbers_one\.runs\.json.*list of runs"):
        made(ONE, tmp_path, lambda line: pytest.fail("made"))


def test_a_result_that_is_cut_off_is_refused(tmp_path):
    path = tmp_path / ONE.key / DONE_FILE
    path.parent.mkdir(parents=True)
    path.write_text("{")
    with pytest.raises(InputError, match=r"numbers/one/done\.json, row 1: .*allowed: JSON"):
        CellStore(tmp_path).read(ONE)


@pytest.mark.parametrize("content", ["[]", "3", '"x"', "{}", '{"settings": {}, "result": {}}'])
def test_a_file_that_is_no_result_is_refused(tmp_path, content):
    path = tmp_path / ONE.key / DONE_FILE
    path.parent.mkdir(parents=True)
    path.write_text(content)
    with pytest.raises(InputError, match=r"numbers/one/done\.json.*a file that `pinwm reproduce` wrote"):
        CellStore(tmp_path).read(ONE)


def test_a_cell_of_other_settings_is_refused_and_kept(tmp_path: Path):
    store = CellStore(tmp_path)
    store.write(ONE, made(ONE, tmp_path, print))
    with pytest.raises(InputError, match=r"numbers/one/done\.json.*other settings \(own: 1, and not 7\)"):
        store.read(Number("one", 7))
    with pytest.raises(InputError, match=r"other settings \(needs: \[\], and not \["):
        store.read(Number("one", 1, (TWO,)))
    assert store.read(ONE)["result"] == {"sum": 1}
    store.write(ALL, made(ONE, tmp_path, print) | {"settings": settings_of(ALL)})
    with pytest.raises(InputError, match=r"other settings \(needs\[0\]\.needs\[1\]\.own: 2, and not 3\)"):
        store.read(Number("all", 100, (Number("both", 10, (ONE, Number("two", 3))), ONE)))


def test_settings_are_plain_data():
    assert json.loads(json.dumps(settings_of(ALL))) == settings_of(ALL)


@dataclass(frozen=True)
class Older:
    """A `Number` as it was before it had hours."""

    name: str
    own: int
    needs: tuple[Number, ...] = ()


def test_a_setting_that_is_added_leaves_cells_as_they_were(tmp_path: Path):
    store, cell = CellStore(tmp_path), Number("both", 10, (ONE,))
    done = {"settings": settings_of(Older("both", 10, (ONE,))) | {"kind": "Number"}, "result": {}, "provenance": {}}
    store.write(cell, done)
    assert store.read(cell) == done
    for other in (
        Number("both", 10, (ONE,), hours=1.0),
        Number("both", 10, (TWO,)),
        Number("both", 10, (ONE, TWO)),
        Number("both", 11, (ONE,)),
    ):
        with pytest.raises(InputError, match="other settings"):
            store.read(other)
    store.write(cell, done | {"settings": done["settings"] | {"more": 1}})
    with pytest.raises(InputError, match="other settings"):
        store.read(cell)


def test_numbers_that_are_not_finite_are_written_as_null_and_refused_in_a_file(tmp_path):
    store, done = CellStore(tmp_path), {"settings": settings_of(ONE), "provenance": {}}
    store.write(ONE, done | {"result": {"a": float("nan")}})
    assert store.read(ONE)["result"] == {"a": None}
    path = tmp_path / ONE.key / DONE_FILE
    path.write_text(path.read_text().replace("null", "Infinity"))
    with pytest.raises(InputError, match="got Infinity; allowed: finite numbers"):
        store.read(ONE)
