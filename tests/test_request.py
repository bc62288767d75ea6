# SPDX-License-Identifier: MIT
import copy
import dataclasses
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Literal

import pytest

from pinwm_drake.errors import ParameterError, require
from pinwm_drake.request import FLATTEN, argument, make_request, option, request, request_fields


@request
class Sizes:
    """Sizes."""

    width: Annotated[int, option("Width of an image.", unit="px", ge=8, le=64)] = 16
    height: Annotated[int, option("Height of an image.", unit="px", ge=8)] = 16


@request
class Order:
    """Order."""

    twin: Annotated[Path, argument("Folder of the twin.", "TWIN")]
    out: Annotated[Path, option("Folder of the results.", "--out", "-o")]
    engine: Annotated[Literal["twin", "point"], option("Engine.")] = "twin"
    sizes: Annotated[Sizes, FLATTEN] = Sizes()
    episodes: Annotated[tuple[str, ...], option("Episodes.", "--episode")] = ()
    inside: int = 3

    def __post_init__(self) -> None:
        """Checks what goes together."""
        require("--episode", self.episodes, self.engine == "twin" or not self.episodes, "none with point")


def test_values_are_of_their_kinds():
    order = Order(Path("a"), "b", episodes=["0000"])
    assert (order.out, order.episodes, order.sizes.width) == (Path("b"), ("0000",), 16)
    assert dataclasses.replace(order, engine="twin") == order
    assert hash(order) == hash(copy.deepcopy(order))
    with pytest.raises(dataclasses.FrozenInstanceError):
        order.out = Path("c")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"engine": "bullet"}, "--engine: got 'bullet'; allowed: twin, point"),
        ({"out": 3}, "--out: got 3; allowed: path"),
        ({"episodes": 3}, "--episode: got 3; allowed: a list of texts"),
        ({"sizes": {"width": 4}}, "--width: got 4; allowed: 8 to 64 px"),
        ({"engine": "point", "episodes": ("0000",)}, "--episode: got ('0000',); allowed: none with point"),
        ({"inside": "x"}, "inside: got 'x'; allowed: a whole number"),
    ],
)
def test_a_wrong_value_names_its_option(values, message):
    with pytest.raises(ParameterError) as caught:
        Order(**{"twin": "a", "out": "b", **values})
    assert str(caught.value) == message


def test_a_missing_value_names_its_option():
    with pytest.raises(ParameterError, match="TWIN: got none; allowed: "):
        Order(out="b")


def test_fields_of_flattened_requests_are_among_the_others():
    fields = {field.name: field for field in request_fields(Order)}
    assert list(fields) == ["twin", "out", "engine", "width", "height", "episodes"]
    assert (fields["width"].owner, fields["width"].default, fields["twin"].default) == (
        "sizes",
        16,
        dataclasses.MISSING,
    )
    made = make_request(Order, {"twin": "a", "out": "b", "height": 32})
    assert made == Order(Path("a"), Path("b"), sizes=Sizes(height=32))


def test_requests_are_light():
    modules = "control twins captures"
    code = f"""
import importlib, sys
for name in {modules.split()}: importlib.import_module("pinwm_drake.experiments.requests." + name)
print([name for name in ("torch", "numba", "pydrake", "matplotlib", "numpy") if name in sys.modules])
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
