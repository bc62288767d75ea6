# SPDX-License-Identifier: MIT
import math
from typing import Annotated, Literal

import numpy as np
import pytest
from pydantic import Field

from pinwm_drake.documents import (
    Document,
    Entry,
    FromList,
    Number,
    Text,
    finite,
    in_words,
    read_yaml,
    schema_version,
    yaml_text,
)
from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import read_bytes


class Part(Document):
    kind: Literal["a", "b"]
    size: Annotated[float, finite(0.0, 2.0)] = 1.0


class Whole(Document):
    schema_version: int = schema_version(3)
    name: Text = "thing"
    pair: Annotated[tuple[Number, Number], FromList] = (0.0, 0.0)
    parts: list[Part] = Field(default_factory=list)
    named: dict[str, Part] = Field(default_factory=dict)
    even: int = in_words("an even number", multiple_of=2, default=0)


def entry(tmp_path, value, place=""):
    return Entry(tmp_path / "file.yaml", place, value)


def test_a_document_becomes_a_model(tmp_path):
    value = {"schema_version": 3, "pair": [1, 2.5], "parts": [{"kind": "a", "size": 2}]}
    found = entry(tmp_path, value).read(Whole)
    assert found.pair == (1.0, 2.5)
    assert found.parts == [Part(kind="a", size=2.0)]
    assert entry(tmp_path, value).problems(Whole) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema_version": 2}, "schema_version = 2; allowed: 3, the version that this release reads"),
        ({"schema_version": True}, "schema_version = true; allowed: 3"),
        ({"name": " "}, 'name = " "; allowed: text'),
        ({"name": "x" * 1001}, "allowed: text of at most 1000 characters"),
        ({"pair": [1.0]}, r"pair = \[1.0\]; allowed: 2 finite numbers"),
        ({"pair": [1.0, math.nan]}, r"pair\[1\] = NaN; allowed: a finite number"),
        ({"pair": [1.0, True]}, r"pair\[1\] = true; allowed: a finite number"),
        ({"parts": [{"kind": "c"}]}, r'parts\[0\].kind = "c"; allowed: a, b'),
        ({"parts": [{"kind": "a"}, {}]}, r"no parts\[1\].kind; allowed: a value under parts\[1\].kind"),
        ({"parts": [{"kind": "a", "size": 3}]}, r"parts\[0\].size = 3; allowed: a finite number from 0 to 2"),
        ({"parts": [{"kind": "a", "Size": 3}]}, r'an unknown key "Size" under parts\[0\]; allowed: kind, size'),
        ({"named": {"x": 1}}, "named.x = 1; allowed: a mapping with keys"),
        ({"named": {"x": {"kind": "c"}}}, 'named.x.kind = "c"; allowed: a, b'),
        ({"named": {1: {"kind": "a"}}}, "named = .*; allowed: a mapping whose keys are text"),
        ({"even": 3}, "even = 3; allowed: an even number"),
        ({2: 3}, "an unknown key 2; allowed: schema_version, name"),
    ],
)
def test_a_wrong_document_is_refused_with_file_place_value_and_what_is_allowed(tmp_path, changes, message):
    with pytest.raises(InputError, match=message) as caught:
        entry(tmp_path, {"schema_version": 3, **changes}).read(Whole)
    assert str(caught.value).startswith(str(tmp_path / "file.yaml"))


def test_places_begin_with_that_of_the_entry_and_all_problems_are_told(tmp_path):
    problems = entry(tmp_path, {"size": 9, "more": 1}, "frames[2]").problems(Part)
    assert [problem.value for problem in problems] == [
        "no frames[2].kind",
        "frames[2].size = 9",
        'an unknown key "more" under frames[2]',
    ]
    with pytest.raises(InputError, match=r"got null; allowed: a mapping with keys"):
        entry(tmp_path, None).read(Part)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.bin: no such file"):
        read_bytes(tmp_path / "nothing.bin")


TEXTS = ["1e3", "-.5E2", "1_0", "0x1f", "012", "1:30", "yes", "null", "~", "=", "<<", "2024-01-01", ".nan", "- a"]


def test_what_is_written_is_read_as_the_same_values(tmp_path):
    random = np.random.default_rng(0)
    alphabet = list("aé🦆 :-#'\"\n\t\r\x85\u2028\ufeff\x7f\x1b\\{}[],&*!|>%@`?0.eE+_~")
    texts = TEXTS + ["".join(random.choice(alphabet, random.integers(0, 200))) for _ in range(1000)]
    numbers = [1e-300, 1e300, -0.1, 1 / 3, 1e16, 5e-324, 0, -(2**70), True, None, [], {}]
    value = {"texts": texts, "numbers": numbers, "same": [numbers, numbers], **{text[:50]: text for text in texts}}
    (tmp_path / "a.yaml").write_text(yaml_text(value), encoding="utf-8", newline="")
    assert read_yaml(tmp_path / "a.yaml").value == value
    assert yaml_text({"a": (1, 2)}) == "a: [1, 2]\n"
