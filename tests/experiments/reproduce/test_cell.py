import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.experiments.reproduce import cell as cells
from pinwm_drake.experiments.reproduce.cell import DONE_FILE, RUNS_FILE, CellStore, in_order, made, settings_of


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


class Slow(Number):
    """A number that says more than a line."""

    def make(self, root, say):
        found = super().make(root, say)
        say("and is done")
        return found


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


def test_runs_that_were_killed_count_with_the_one_that_ends(tmp_path: Path, monkeypatch):
    def killed(line):
        raise KeyboardInterrupt

    monkeypatch.setattr(cells, "_PERIOD", -1.0)
    clock = iter(range(0, 6000, 60))  # a minute goes by each time that it is looked at
    monkeypatch.setattr(cells.time, "monotonic", lambda: float(next(clock)))

    def run(machine, say):
        monkeypatch.setattr(cells, "_machine", lambda: machine)
        return made(Slow("slow", 5), tmp_path, say)

    with pytest.raises(KeyboardInterrupt):
        run("another", lambda line: None if line == "adds 5" else killed(line))
    told = json.loads((tmp_path / "numbers/slow" / RUNS_FILE).read_text())
    assert [(one["machine"], one["minutes"]) for one in told] == [("another", 3.0)]
    provenance = run("this", print)["provenance"]
    assert [one["machine"] for one in provenance["runs"]] == ["another", "this"]
    assert provenance["machine"] == "this"
    assert provenance["minutes"] == sum(one["minutes"] for one in provenance["runs"]) > 3.0
    assert not (tmp_path / "numbers/slow" / RUNS_FILE).exists()
    assert "runs" not in run("this", print)["provenance"]


def test_a_cell_of_other_settings_is_refused_and_kept(tmp_path: Path):
    store = CellStore(tmp_path)
    store.write(ONE, made(ONE, tmp_path, print))
    with pytest.raises(InputError, match=r"numbers/one/done\.json.*other settings"):
        store.read(Number("one", 7))
    with pytest.raises(InputError, match="other settings"):
        store.read(Number("one", 1, (TWO,)))
    assert store.read(ONE)["result"] == {"sum": 1}
    (tmp_path / ONE.key / DONE_FILE).write_text("{")
    with pytest.raises(InputError, match="done"):
        store.read(ONE)


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
