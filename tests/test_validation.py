from typing import Annotated, Literal

import pytest
from pydantic import ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass

from pinwm_drake.validation import first_problem


@dataclass(config=ConfigDict(extra="forbid"))
class Inner:
    x: Annotated[float, Field(ge=0, le=2, json_schema_extra={"unit": "m"})] = 1.0


@dataclass(config=ConfigDict(extra="forbid"))
class Outer:
    count: Annotated[int | None, Field(ge=1)] = None
    engine: Literal["twin", "point"] = "twin"
    pair: tuple[float, float] = (0, 0)
    inner: Inner = Field(default_factory=Inner)
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
        ({"pair": (1,)}, "pair[1]", "a value under pair[1]"),
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
