import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.experiments.reproduce.cell import DONE_FILE, CellStore, in_order, made, settings_of


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
