# SPDX-License-Identifier: MIT
from dataclasses import FrozenInstanceError, dataclass, field
from typing import Annotated, Literal

import numpy as np
import pytest
from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass

from pinwm_drake.errors import ParameterError
from pinwm_drake.validation import Problem, Refusal, check_fields, document_of, first_problem, from_document

Metres = Annotated[float, Field(gt=0, json_schema_extra={"unit": "m"})]


@dataclass(frozen=True)
class Box:
    size: tuple[Metres, Metres]
    name: str = "box"

    def __post_init__(self):
        check_fields(self, "box.")


@dataclass(frozen=True)
class Shelf:
    box: Annotated[Box, document_of(Box, "box")]
    height: Metres

    def __post_init__(self):
        check_fields(self)


def test_numbers_of_a_dataclass_become_plain_ones():
    box = Box(np.array([1, 2]))
    assert box == Box([1.0, np.float64(2.0)]) == Box((1, 2))
    assert [type(value) for value in box.size] == [float, float]
    with pytest.raises(FrozenInstanceError):
        box.name = "other"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"size": (1.0, 0.0)}, r"^box\.size: got \(1\.0, 0\.0\); allowed: more than 0 m$"),
        ({"size": (1.0, np.nan)}, r"^box\.size: got \(1\.0, nan\); allowed: more than 0 m$"),
        ({"size": (1.0, True)}, r"^box\.size: got \(1\.0, True\); allowed: more than 0 m$"),
        ({"size": (1.0,)}, r"^box\.size: got \(1\.0,\); allowed: 2 finite numbers$"),
        ({"size": (1.0, 1.0), "name": 3}, r"^box\.name: got 3; allowed: text$"),
    ],
)
def test_a_wrong_field_is_named_with_what_is_allowed(values, message):
    with pytest.raises(ParameterError, match=message):
        Box(**values)


def test_a_document_has_all_fields_and_no_other_keys():
    document = {"box": {"size": [1, 2], "name": "mine"}, "height": 3}
    assert from_document(Shelf, document, "shelf") == Shelf(Box((1.0, 2.0), "mine"), 3.0)
    for wrong, message in (
        ({"height": 3}, r"^shelf: got \['height'\]; allowed: the keys box, height$"),
        (document | {"depth": 1}, r"^shelf: got \['box', 'depth', 'height'\]; allowed: the keys box, height$"),
        (None, r"^shelf: got None; allowed: the keys box, height$"),
        (document | {"box": {}}, r"^box: got \[\]; allowed: the keys size, name$"),
        (document | {"box": {"size": [0, 1], "name": "mine"}}, r"^box\.size: got \(0, 1\); allowed: more than 0 m$"),
    ):
        with pytest.raises(ParameterError, match=message):
            from_document(Shelf, wrong, "shelf")


def _ordered(plate: "Plate") -> "Plate":
    if plate.low >= plate.high:
        raise Refusal("below high", "low")
    return plate


@dataclass
class Plate:
    __pydantic_config__ = ConfigDict(extra="forbid")

    low: float = 0.0
    high: float = 1.0


@dataclass
class Table:
    plate: Annotated[Plate, AfterValidator(_ordered)] = field(default_factory=Plate)


def _problem(document) -> Problem:
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(Table).validate_python(document)
    return first_problem(caught.value, Table)


def test_a_validator_names_an_entry_below_its_own():
    found = _problem({"plate": {"low": 2, "high": 1}})
    assert (found.place, found.value, found.allowed) == ("plate.low", 2, "below high")
    found = _problem({"plate": {"high": -1}})  # the wrong entry is not in the document
    assert (found.place, found.value, found.allowed) == ("plate", {"high": -1}, "below high")


def test_plain_dataclasses_are_understood():
    found = _problem({"plate": {"low": "x"}})
    assert (found.kind, found.place, found.allowed) == ("float_parsing", "plate.low", "a finite number")
    found = _problem({"plate": {"depth": 1}})
    assert (found.kind, found.place, found.allowed) == ("extra_forbidden", "plate.depth", "low, high")
    assert _problem({"plate": {3: 1}}).allowed == "low, high"
    assert _problem({"plate": None}).allowed == "a mapping with keys"


@pydantic_dataclass(config=ConfigDict(extra="forbid"))
class Corner:
    x: Annotated[float, Field(ge=0, le=2, json_schema_extra={"unit": "m"})] = 1.0


@pydantic_dataclass(config=ConfigDict(extra="forbid"))
class Outer:
    count: Annotated[int | None, Field(ge=1)] = None
    engine: Literal["twin", "point"] = "twin"
    pair: tuple[float, float] = (0, 0)
    inner: Corner = Field(default_factory=Corner)
    weights: list[Annotated[float, Field(gt=0, lt=1)]] = Field(default_factory=list)
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 0
    shape: Annotated[str, Field(pattern="^a", json_schema_extra={"allowed": "a text that begins with a"})] = "a"


@pytest.mark.parametrize(
    ("values", "place", "allowed"),
    [
        ({"count": 0}, "count", "1 or more"),
        ({"count": "many"}, "count", "1 or more"),
        ({"engine": "bullet"}, "engine", "twin, point"),
        ({"pair": (1, "x")}, "pair[1]", "a finite number"),
        ({"pair": (1,)}, "pair", "2 finite numbers"),
        ({"inner": {"x": 3}}, "inner.x", "0 to 2 m"),
        ({"inner": {"y": 3}}, "inner.y", "x"),
        ({"inner": 3}, "inner", "a mapping with keys"),
        ({"weights": [0.5, 1]}, "weights[1]", "more than 0, less than 1"),
        ({"seed": -1}, "seed", "0 to 4294967295"),
        ({"shape": "b"}, "shape", "a text that begins with a"),
        ({"size": 1}, "size", "count, engine, pair, inner, weights, seed, shape"),
    ],
)
def test_a_problem_names_its_place_and_what_is_allowed(values, place, allowed):
    with pytest.raises(ValidationError) as caught:
        Outer(**values)
    problem = first_problem(caught.value, Outer)
    assert (problem.place, problem.allowed) == (place, allowed)
