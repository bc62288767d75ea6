# SPDX-License-Identifier: MIT
import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.patch import corner_spread
from pinwm_drake.geometry.stored_pieces import mesh_primitives
from pinwm_drake.identification.identify import chosen_unknowns, object_priors
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.unknowns import DEFAULT_FREE, UNKNOWNS, Coordinates
from pinwm_drake.models import object_model
from pinwm_drake.scene import make_scene
from pinwm_drake.spatial.poses import Pose


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
    assert float(values["friction_floor"][0]) == pytest.approx(0.2 * math.exp(0.2))
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
    assert float(floor.min()) < 0.05
    assert float(floor.max()) > 0.3
    assert (coordinates.values(first)["lift"] == 0).all()


@pytest.mark.parametrize(
    ("free", "held", "words"),
    [
        (("friction",), {}, "unknown: got 'friction'"),
        ((), {}, "one or more"),
        (("lift", "lift"), {}, "each once"),
        (("lift",), {"friction_floor": -1.0}, "friction_floor: got -1.0 to be held at"),
        (("lift",), {"mass": 0.0}, "mass: got 0.0 to be held at"),
        (("lift",), {"restitution_floor": 1.5}, "allowed: 0 to 1"),
        (("lift",), {"mass": math.nan}, "mass: got nan to be held at"),
    ],
)
def test_nonsense_is_refused(free, held, words):
    with pytest.raises(ParameterError, match=words):
        Coordinates(free, held)


def test_frictions_are_alike_before_any_image_is_seen():
    coordinates = Coordinates(("friction_floor", "friction_pusher"), {})
    together, apart = torch.tensor([[2.0, 2.0], [2.0, -2.0]], dtype=torch.float64)
    # In logarithms: 0.4 each with a deviation of 1, and a difference of 0.8 with one of 1.5.
    assert float(coordinates.penalty(together)) == pytest.approx(0.5 * 2 * 0.4**2)
    assert float(coordinates.penalty(apart)) == pytest.approx(0.5 * (2 * 0.4**2 + (0.8 / 1.5) ** 2))
    # One alone has its own prior only.
    alone = Coordinates(("friction_floor",), {})
    assert float(alone.penalty(torch.tensor([2.0], dtype=torch.float64))) == pytest.approx(0.5 * 0.4**2)


def test_pushes_share_the_object_and_have_starts_of_their_own():
    coordinates = Coordinates(("start_x", "friction_floor", "lift"), {}, pushes=3)
    assert coordinates.names == ["friction_floor", "lift", "start_x.0", "start_x.1", "start_x.2"]
    assert coordinates.columns(1) == [0, 1, 3]
    z = torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0], dtype=torch.float64)
    values = [coordinates.values(z, push) for push in range(3)]
    assert [float(value["start_x"]) for value in values] == pytest.approx([6e-3, 8e-3, 10e-3])
    assert len({float(value["friction_floor"]) for value in values}) == 1
    assert list(coordinates.named(z)) == coordinates.names
    assert coordinates.named(z)["start_x.2"] == pytest.approx(10e-3)


def test_what_is_known_of_one_object_takes_the_place_of_a_prior():
    usual = Coordinates(("contact_offset", "start_x"), {}, 2)
    wider = Coordinates(("contact_offset", "start_x"), {}, 2, [{}, {"start_x": 2e-3}], {"contact_offset": 3e-3})
    assert usual.deviations == [1e-3, 1e-3, 1e-3]
    assert wider.deviations == [3e-3, 1e-3, 2e-3]
    assert float(wider.precision[0, 0]) == pytest.approx(float(usual.precision[0, 0]) / 9.0)


def test_a_centre_of_mass_that_may_be_far_off_is_searched_for_as_far():
    usual = Coordinates(("center_x", "contact_offset"), {})
    told = Coordinates(("center_x", "contact_offset"), {}, shared={"center_x": 5e-3, "contact_offset": 5e-3})
    generators = [torch.Generator().manual_seed(0) for _ in range(2)]
    near, far = (one.values(one.draw(400, generator)) for one, generator in zip((usual, told), generators, strict=True))
    # Half of them have that of a uniform solid.
    assert int((far["center_x"] == 0.0).sum()) == 200
    assert float(near["center_x"].abs().max()) == 0.0
    assert float(far["center_x"].abs().max()) == pytest.approx(5e-3, rel=0.02)
    assert float(far["contact_offset"].abs().max()) == 0.0
    # A standard deviation of the centre costs one half.
    z = torch.tensor([told._z_of(told.free[0], 5e-3), 0.0], dtype=torch.float64)
    assert float(told.penalty(z)) == pytest.approx(0.5)
    assert float(told.values(z)["center_x"]) == pytest.approx(5e-3)


def mug_on_the_floor(q):
    """Capture of a mug with an orientation, as far as priors need it, and its scene."""
    path = object_model("mug").mesh_path
    pose = Pose(torch.tensor(q, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))
    capture = SimpleNamespace(object=SimpleNamespace(mesh_path=path, X_WO=pose, mesh_error=0.0))
    pusher = PusherGeometry(None, PusherShape("sphere", 0.01))
    return capture, make_scene(path, pusher, q_WO=pose.q, gravity=9.81, acts_as=mesh_primitives(path))


@pytest.mark.parametrize(
    ("q", "expected"), [((0.5**0.5, 0.5**0.5, 0.0, 0.0), 1.0 / 0.53), ((1.0, 0.0, 0.0, 0.0), None)]
)
def test_corners_of_a_lying_mug_are_the_ends_of_its_line(q, expected):
    # A standing one has the corners of its face.
    capture, scene = mug_on_the_floor(q)
    free, held = chosen_unknowns(capture, IdentifyOptions(support="corners"), scene, 1.0)
    assert not any(name.startswith("support") for name in free)
    found = [held[f"support_{axis}"] for axis in "xyz"]
    assert found == pytest.approx(corner_spread(scene.mesh, np.eye(3)) if expected is None else 3 * [expected])
    assert found[0] > 1.2


@pytest.mark.parametrize(("q", "deviation"), [((0.5**0.5, 0.5**0.5, 0.0, 0.0), 4.8e-3), ((1.0, 0.0, 0.0, 0.0), None)])
def test_the_centre_of_mass_of_what_rolls_may_be_far_off(q, deviation):
    # Half of the diagonal of 80 by 80 by 80 mm is 69 mm; that of one which stands has the usual prior.
    capture, scene = mug_on_the_floor(q)
    priors = object_priors(capture, scene)
    assert priors["contact_offset"] == 1e-3
    assert priors.get("center_x") == (None if deviation is None else pytest.approx(deviation, rel=0.02))
