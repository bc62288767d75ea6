# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.baselines.asid.cross_entropy import GENEROUS, CrossEntropyBudget, minimise

CENTRE = np.array([0.2, 0.7, 0.95])


def bowl(points):
    """Squared distance from a point, each coordinate weighed otherwise."""
    return ((points - CENTRE) ** 2 * [1.0, 4.0, 0.25]).sum(-1)


def search(function, budget=GENEROUS, number=3, seed=0):
    return minimise(function, number, budget, np.random.default_rng(seed))


def test_the_minimum_of_a_bowl_is_found():
    found = search(bowl)
    # A round shrinks the Gaussian of 200 points at least to the best tenth's width, about 0.5 in three dimensions:
    # after 20 rounds 1e-6 of the cube.
    assert found.point == pytest.approx(CENTRE, abs=1e-3)
    assert found.value == pytest.approx(float(bowl(found.point[None])[0]))
    assert found.value == found.rounds.min()


def test_it_is_better_than_as_many_random_points():
    number = GENEROUS.samples * GENEROUS.rounds
    assert search(bowl).value < 0.01 * bowl(np.random.default_rng(0).random((number, 3))).min()


def test_points_without_a_value_are_passed_over():
    def cut(points):
        return np.where(points[:, 0] < 0.5, np.inf, bowl(points))

    found = search(cut)
    assert found.point[0] == pytest.approx(0.5, abs=1e-2)
    assert found.point[1:] == pytest.approx(CENTRE[1:], abs=2e-2)


def test_no_value_anywhere_is_told():
    found = search(lambda points: np.full(len(points), np.inf), CrossEntropyBudget())
    assert np.isinf(found.value)


def test_points_stay_in_the_cube_and_count_as_the_budget_says():
    seen = []

    def outside(points):
        seen.append(points)
        return -points.sum(-1)

    budget = CrossEntropyBudget(samples=30, elites=5, rounds=7)
    found = minimise(outside, 2, budget, np.random.default_rng(3))
    points = np.concatenate(seen)
    assert points.shape == (210, 2)
    assert points.min() >= 0.0
    assert points.max() <= 1.0
    # Near the corner: five elites tell the width too small, and a search of seven rounds stops short.
    assert found.point == pytest.approx([1.0, 1.0], abs=0.05)


def test_a_seed_gives_the_same_search():
    first, again, other = (search(bowl, CrossEntropyBudget(), seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first.point, again.point)
    assert not np.array_equal(first.point, other.point)


@pytest.mark.parametrize("change", [{"samples": 1}, {"elites": 1}, {"elites": 21}, {"rounds": 0}])
def test_budgets_out_of_range_are_refused(change):
    with pytest.raises(ParameterError, match=next(iter(change))):
        CrossEntropyBudget(**change)
