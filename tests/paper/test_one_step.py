# SPDX-License-Identifier: MIT
"""One-step errors."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError
from pinwm_drake.paper.baselines.dreamer.world_model import WorldModel
from pinwm_drake.paper.one_step import (
    Outcomes,
    SeenOutcomes,
    imagine,
    outcomes_at_rest,
    picture_errors,
    plant_outcomes,
    see_outcomes,
    step_errors,
)
from pinwm_drake.systems.scenario.load import load_setup
from tests.paper.baselines.dreamer.small import SIZES


@pytest.fixture(scope="module")
def outcomes():
    return plant_outcomes("push_t", "twin", 3, 0)


def test_a_twin_of_the_true_theta_has_no_error_and_another_one_has(outcomes):
    setup = load_setup("push_t")
    same = step_errors(setup, outcomes)
    assert same.shape == (3, 2)
    assert np.abs(same).max() < 1e-9
    assert step_errors(setup.with_theta(friction_pusher=0.8), outcomes).max() > 1e-4


def test_an_object_is_followed_until_it_rests(outcomes):
    setup, rest = load_setup("push_t"), 20
    found = outcomes_at_rest("push_t", "twin", outcomes, rest)
    assert np.abs(step_errors(setup, found, rest)).max() < 1e-9
    # It slides on over the slippery floor, as far along its way as its speed takes it.
    along = np.linalg.norm(found.moved, axis=1) - np.linalg.norm(outcomes.moved, axis=1)
    assert (along > 0.01).all()
    longer = outcomes_at_rest("push_t", "twin", outcomes, rest + 5)
    np.testing.assert_allclose(longer.moved, found.moved, atol=1e-9)
    np.testing.assert_allclose(outcomes_at_rest("push_t", "twin", outcomes, 0).moved, outcomes.moved, atol=1e-12)
    for name in ("q_WO", "p_WO", "p_WP", "action", "longest"):
        np.testing.assert_array_equal(getattr(found, name), getattr(outcomes, name))


def test_a_twin_whose_floor_is_lower_begins_there(outcomes):
    setup = load_setup("push_t")
    lower = replace(setup, twin=replace(setup.twin, floor_height=setup.twin.floor_height - 0.004))
    found = step_errors(lower, outcomes)
    assert found[:, 0] == pytest.approx(0.0, abs=2e-3)  # a pusher that meets it 4 mm higher; no fall


def test_outcomes_are_kept_and_follow_from_the_seed(outcomes, tmp_path):
    outcomes.write(tmp_path / "outcomes.npz")
    read = Outcomes.read(tmp_path / "outcomes.npz")
    again = plant_outcomes("push_t", "twin", 3, 0)
    for name in Outcomes.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(read, name), getattr(outcomes, name))
        np.testing.assert_array_equal(getattr(again, name), getattr(outcomes, name))
    assert np.linalg.norm(outcomes.moved, axis=1).min() > 1e-3
    with pytest.raises(InputError, match="no such file"):
        Outcomes.read(tmp_path / "none.npz")


def test_actions_are_as_long_as_they_are_asked_to_be(outcomes):
    assert float(outcomes.longest) == pytest.approx(0.03)  # the longest that the scene's pusher can do
    short = plant_outcomes("push_t", "twin", 1, 0, max_translation=0.02)
    assert float(short.longest) == 0.02
    assert step_errors(load_setup("push_t"), short).max() < 1e-9


@pytest.fixture(scope="module")
def pushed():
    return plant_outcomes("push_t", "twin", 2, 0, max_translation=0.02)


@pytest.fixture(scope="module")
def seen(pushed):
    return see_outcomes("push_t", "twin", pushed)


def test_what_is_seen_is_the_start_the_rest_and_the_action(pushed, seen, tmp_path):
    assert seen.image.shape == (2, 7, 64, 64, 3)
    assert (seen.image[:, 1:-1] == seen.image[:, 1:2]).mean() > 0.999  # at rest
    assert (seen.image[:, -1] != seen.image[:, -2]).any((1, 2, 3)).all()
    assert np.abs(seen.pusher[:, :-1] - seen.pusher[:, :1]).max() < 1e-6
    way = np.linalg.norm(seen.p_WP - pushed.p_WP, axis=1)
    assert way.max() < 0.02 + 1e-6
    assert way.min() > 0.015
    seen.write(tmp_path / "seen.npz")
    again = SeenOutcomes.read(tmp_path / "seen.npz")
    for name in SeenOutcomes.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(again, name), getattr(seen, name))
    with pytest.raises(InputError, match="no such file"):
        SeenOutcomes.read(tmp_path / "none.npz")


def test_the_truth_has_the_error_of_reading_alone_and_a_model_in_which_nothing_moves_that_of_the_motion(pushed, seen):
    setup = load_setup("push_t")
    true = picture_errors(setup, pushed, seen, seen.after, num_threads=1)
    way = np.linalg.norm(pushed.moved, axis=1)
    assert true[:, 0].max() < 1.5e-3  # a pixel has 8 mm
    assert true[:, 1].max() < 0.03
    still = picture_errors(setup, pushed, seen, seen.image[:, -2] / 255.0, num_threads=1)
    assert still[:, 0] == pytest.approx(way, abs=1.5e-3)


def test_a_model_imagines_the_same_image_again_and_does_not_look_at_what_came(seen):
    torch.manual_seed(0)
    model = WorldModel(64, 2, SIZES).requires_grad_(False)
    images = imagine(model, seen)
    assert images.shape == (2, 64, 64, 3)
    assert images.min() >= 0.0
    assert images.max() <= 1.0
    later = seen.image.copy()
    later[:, -1] = 0
    other = SeenOutcomes(later, seen.pusher, seen.action, seen.before, seen.p_WP)
    np.testing.assert_array_equal(imagine(model, other), images)
    still = SeenOutcomes(seen.image, seen.pusher, 0.0 * seen.action, seen.before, seen.p_WP)
    assert (imagine(model, still) != images).any()
