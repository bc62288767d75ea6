# SPDX-License-Identifier: MIT
import math

import pytest
import torch

from pinwm_drake.identification.search import representative
from pinwm_drake.identification.unknowns import Coordinates

COORDINATES = Coordinates(("restitution_floor", "friction_floor"), {})


def drawn(peak, number=4000):
    """Draws of a normal density with its peak at (0.5, peak), none with a restitution below 0, and their objectives."""
    z = torch.randn(4 * number, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    z = z + torch.tensor([0.5, peak])
    z = z[z[:, 1] >= 0.0][:number]
    return z, objective(peak)(z)


def objective(peak):
    return lambda z: 0.5 * ((z - torch.tensor([0.5, peak])) ** 2).sum(-1)


@pytest.mark.parametrize("peak", [-1.0, 0.0, 0.4])
def test_a_restitution_whose_draws_are_densest_at_zero_is_zero_and_the_friction_their_mean(peak):
    draws, energies = drawn(peak)
    found = representative(objective(peak), COORDINATES, draws, energies)
    assert COORDINATES.values(found)["restitution_floor"] == 0.0
    assert float(found[0]) == pytest.approx(0.5, abs=0.05)


def test_the_friction_goes_with_a_restitution_that_is_set_to_zero():
    # Half a normal density of the restitution, with which the friction grows.
    z = torch.randn(4000, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    draws = torch.stack([0.3 * z[:, 0] + 0.8 * z[:, 1].abs(), z[:, 1].abs()], -1)

    def objective(z):
        return 0.5 * ((z[:, 0] - 0.8 * z[:, 1]) / 0.3).square() + 0.5 * z[:, 1].square()

    found = representative(objective, COORDINATES, draws, objective(draws))
    assert float(found[1]) == 0.0
    assert float(found[0]) == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize("peak", [0.8, 1.5, 4.0])
def test_other_restitutions_are_the_mean_of_their_draws(peak):
    draws, energies = drawn(peak)
    found = representative(objective(peak), COORDINATES, draws, energies)
    torch.testing.assert_close(found, draws.mean(0))
    assert float(found[1]) >= 0.95 * peak


def ring(z):
    """A density along a bow around (0, 0), whose mean and whose bound are both less likely than it is."""
    return 500.0 * (torch.linalg.vector_norm(z, dim=-1) - 1.0) ** 2


def test_a_bent_posterior_has_one_of_its_likely_draws():
    turns = torch.linspace(-0.45 * math.pi, 0.45 * math.pi, 500, dtype=torch.float64)
    draws = torch.stack([turns.cos(), turns.sin()], -1)
    found = representative(ring, COORDINATES, draws, ring(draws))
    assert any(torch.equal(found, one) for one in draws)
