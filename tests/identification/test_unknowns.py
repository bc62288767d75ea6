import math

import pytest
import torch

from pinwm_drake.errors import ParameterError
from pinwm_drake.identification.unknowns import DEFAULT_FREE, UNKNOWNS, Coordinates


def test_zero_is_nominal_or_held():
    coordinates = Coordinates(DEFAULT_FREE, {"mass": 0.7, "friction_floor": 0.3})
    values = coordinates.values(torch.zeros(2, len(coordinates), dtype=torch.float64))
    assert values["mass"].tolist() == [0.7, 0.7]
    assert values["friction_floor"].tolist() == pytest.approx([0.3, 0.3])
    assert set(values) == set(UNKNOWNS)
    for name, unknown in UNKNOWNS.items():
        if name not in ("mass", "friction_floor"):
            assert values[name][0] == pytest.approx(unknown.nominal)


def test_one_is_the_scale():
    coordinates = Coordinates(("friction_floor", "start_x"), {})
    values = coordinates.values(torch.ones(1, 2, dtype=torch.float64))
    assert float(values["friction_floor"][0]) == pytest.approx(0.1 * math.exp(0.3))
    assert float(values["start_x"][0]) == pytest.approx(2e-3)


def test_values_stay_within_bounds():
    coordinates = Coordinates(("restitution_floor", "friction_floor"), {})
    far = torch.tensor([[1e3, 1e3], [-1e3, -1e3]], dtype=torch.float64)
    values = coordinates.values(coordinates.clamp(far))
    assert values["restitution_floor"].tolist() == pytest.approx([1.0, 0.0])
    assert values["friction_floor"].tolist() == pytest.approx([5.0, 1e-4])


def test_draws_are_seeded_and_begin_with_the_centre():
    coordinates = Coordinates(DEFAULT_FREE, {})
    first, second = (coordinates.draw(50, torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(first, second)
    assert (first[0] == 0).all()
    floor = coordinates.values(first)["friction_floor"]
    assert float(floor.min()) < 0.03
    assert float(floor.max()) > 0.3
    assert (coordinates.values(first)["lift"] == 0).all()


@pytest.mark.parametrize(
    ("free", "held", "words"),
    [
        (("friction",), {}, "'friction' is no unknown"),
        ((), {}, "one or more"),
        (("lift", "lift"), {}, "each once"),
        (("lift",), {"friction_floor": -1.0}, "friction_floor is held at -1.0"),
        (("lift",), {"mass": 0.0}, "mass is held at 0.0"),
        (("lift",), {"restitution_floor": 1.5}, "allowed: 0 to 1"),
        (("lift",), {"mass": math.nan}, "mass is held at nan"),
    ],
)
def test_nonsense_is_refused(free, held, words):
    with pytest.raises(ParameterError, match=words):
        Coordinates(free, held)


def test_frictions_are_alike_before_any_image_is_seen():
    coordinates = Coordinates(("friction_floor", "friction_pusher"), {})
    together, apart = torch.tensor([[2.0, 2.0], [2.0, -2.0]], dtype=torch.float64)
    # In logarithms: 0.6 each with a deviation of 2, and a difference of 1.2 with one of 0.7.
    assert float(coordinates.penalty(together)) == pytest.approx(0.5 * 2 * (0.6 / 2) ** 2)
    assert float(coordinates.penalty(apart)) == pytest.approx(0.5 * (2 * (0.6 / 2) ** 2 + (1.2 / 0.7) ** 2))
    # One alone has its own prior only.
    alone = Coordinates(("friction_floor",), {})
    assert float(alone.penalty(torch.tensor([2.0], dtype=torch.float64))) == pytest.approx(0.5 * (0.6 / 2) ** 2)
