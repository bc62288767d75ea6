# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.cousins.randomization import FLIP_SPANS, RandomDomains, Spans
from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.twin.twin import THETA


@pytest.fixture(scope="module")
def twin():
    return load_setup("push_t").twin


def thetas(source, twin, number=200):
    draw = source.draw(twin)
    return {name: np.array([draw(k).theta[name] for k in range(number)]) for name in THETA}


def test_all_of_the_ranges_is_drawn_and_nothing_beyond(twin):
    found = thetas(RandomDomains(), twin)
    for name, (low, high) in {
        "friction_floor": (0.005, 0.5),
        "friction_pusher": (0.005, 0.5),
        "mass": (0.2, 5.0),
        "restitution_floor": (0.0, 0.5),
    }.items():
        assert low <= found[name].min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < found[name].max() <= high
    solid = mass_properties(load_mesh(twin.mesh_path), mass=1.0).inertia
    factor = found["inertia_zz"] / (found["mass"] * solid[2, 2])
    assert 0.3 <= factor.min() < 0.6 < 2.7 < factor.max() <= 3.0
    np.testing.assert_allclose(found["inertia_xx"] / found["inertia_zz"], solid[0, 0] / solid[2, 2])
    # One does not follow from another.
    assert abs(np.corrcoef(found["friction_floor"], found["friction_pusher"])[0, 1]) < 0.3


def test_a_share_lies_around_the_truth_within_the_ranges(twin):
    middle = {name: twin.theta[name].value for name in THETA} | {"friction_floor": 0.03, "mass": 1.0}
    found = thetas(RandomDomains(share=0.25, middle=middle), twin)
    assert 0.005 <= found["friction_floor"].min() < 0.012
    assert 0.08 < found["friction_floor"].max() <= 0.03 + 0.125 * 0.495
    assert 0.4 <= found["mass"].min() < 0.5 < 1.5 < found["mass"].max() <= 1.6


def test_one_guess_is_that_of_all_episodes_and_another_seed_has_another(twin):
    once = thetas(RandomDomains(once=True), twin, 5)
    assert {len(set(values)) for values in once.values()} == {1}
    assert once["mass"][0] != thetas(RandomDomains(once=True, seed=1), twin, 1)["mass"][0]
    again = RandomDomains(once=True).draw(twin)(3)
    assert again.theta["mass"] == once["mass"][0]


def test_what_was_identified_has_no_part(twin):
    moved = load_setup("push_t").with_theta(friction_floor=0.4, mass=3.0).twin
    assert RandomDomains().draw(twin)(7).theta == RandomDomains().draw(moved)(7).theta


def test_colours_are_those_of_the_twin_or_drawn_once(twin):
    plain, painted = RandomDomains().draw(twin), RandomDomains(painted=True).draw(twin)
    assert plain(0).sh is twin.surfels.sh
    assert (painted(0).sh == painted(1).sh).all()
    colours = 0.5 + 0.28209479177387814 * painted(0).sh[:, 0].numpy()
    assert colours.min() >= -1e-6
    assert colours.max() <= 1.0 + 1e-6
    assert colours.std(axis=0).min() > 0.2
    assert not painted(0).sh[:, 1:].any()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Spans(friction=(0.5, 0.1)),
        lambda: Spans(mass=(0.0, 1.0)),
        lambda: Spans(restitution=(0.0, 1.5)),
        lambda: RandomDomains(share=0.0),
        lambda: RandomDomains(share=0.5),
        lambda: RandomDomains(share=0.5, middle={"friction": 0.1}),
        lambda: RandomDomains(seed=-1),
    ],
)
def test_ranges_that_make_no_sense_are_refused(make):
    with pytest.raises(ParameterError):
        make()


def test_flip_has_rougher_floors():
    assert FLIP_SPANS.friction == (0.05, 1.0)
    assert FLIP_SPANS.mass == Spans().mass
