# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
from pydrake.multibody.plant import CalcContactFrictionFromSurfaceProperties, CoulombFriction
from scipy.integrate import solve_ivp

from pinwm_drake.systems.sdf.contact import dissipation_of, surface_frictions


@pytest.mark.parametrize(("floor", "pusher"), [(0.03, 0.03), (0.03, 0.5), (0.9, 0.1), (0.2, 0.0), (0.0, 0.0)])
def test_pairs_of_surfaces_have_the_friction_that_is_asked_for(floor, pusher):
    mu_object, mu_floor, mu_pusher = (CoulombFriction(mu, mu) for mu in surface_frictions(floor, pusher))
    for mu, expected in ((mu_floor, floor), (mu_pusher, pusher)):
        pair = CalcContactFrictionFromSurfaceProperties(mu_object, mu)
        assert pair.dynamic_friction() == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("restitution", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("speed", [0.05, 0.3])
def test_hunt_and_crossley_bounce_with_the_restitution_that_is_asked_for(restitution, speed):
    # m x'' = -k x (1 + d x'), any k / m: integrated through the contact.
    d = dissipation_of(restitution, speed)
    leave = lambda t, y: y[0]  # noqa: E731
    leave.terminal, leave.direction = True, -1
    motion = solve_ivp(
        lambda t, y: [y[1], -1e4 * y[0] * (1 + d * y[1])], (0, 10), [0, speed], events=leave, rtol=1e-10, atol=1e-14
    )
    assert -motion.y[1, -1] / speed == pytest.approx(restitution, rel=1e-5)


def test_less_restitution_takes_more_dissipation_up_to_a_limit():
    values = [dissipation_of(e, 0.1) for e in np.linspace(0, 0.9, 19)]
    assert np.all(np.diff(values) < 0)
    # Bodies part at no more than 1 / d.
    assert values[0] >= 500
    assert math.isfinite(values[0])


@pytest.mark.parametrize("restitution", [0.021, 0.0257, 0.03])
def test_small_restitutions_have_a_dissipation_near_their_limit(restitution):
    # d u -> 1 / e for a small e, from below.
    found = dissipation_of(restitution, 0.2)
    assert found * 0.2 * restitution == pytest.approx(1.0, abs=1e-9)
    assert found <= dissipation_of(0.02, 0.2)
