import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError
from pinwm_drake.paper.baselines.dreamer.world_model import WorldModel
from pinwm_drake.paper.imagined_step import SeenOutcomes, imagine, picture_errors, see_outcomes
from pinwm_drake.paper.one_step import plant_outcomes
from pinwm_drake.systems.scenario.load import load_setup
from tests.paper.baselines.dreamer.small import SIZES


@pytest.fixture(scope="module")
def outcomes():
    return plant_outcomes("push_t", "twin", 2, 0, max_translation=0.02)


@pytest.fixture(scope="module")
def seen(outcomes):
    return see_outcomes("push_t", "twin", outcomes)


def test_what_is_seen_is_the_start_the_rest_and_the_action(outcomes, seen, tmp_path):
    assert seen.image.shape == (2, 7, 64, 64, 3)
    assert (seen.image[:, 1:-1] == seen.image[:, 1:2]).mean() > 0.999  # at rest
    assert (seen.image[:, -1] != seen.image[:, -2]).any((1, 2, 3)).all()
    assert np.abs(seen.pusher[:, :-1] - seen.pusher[:, :1]).max() < 1e-6
    way = np.linalg.norm(seen.p_WP - outcomes.p_WP, axis=1)
    assert way.max() < 0.02 + 1e-6
    assert way.min() > 0.015
    seen.write(tmp_path / "seen.npz")
    again = SeenOutcomes.read(tmp_path / "seen.npz")
    for name in SeenOutcomes.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(again, name), getattr(seen, name))
    with pytest.raises(InputError, match="no such file"):
        SeenOutcomes.read(tmp_path / "none.npz")


def test_the_truth_has_the_error_of_reading_alone_and_a_model_in_which_nothing_moves_that_of_the_motion(outcomes, seen):
    setup = load_setup("push_t")
    true = picture_errors(setup, outcomes, seen, seen.after, num_threads=1)
    way = np.linalg.norm(outcomes.moved, axis=1)
    assert true[:, 0].max() < 1.5e-3  # a pixel has 8 mm
    assert true[:, 1].max() < 0.03
    still = picture_errors(setup, outcomes, seen, seen.image[:, -2] / 255.0, num_threads=1)
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
