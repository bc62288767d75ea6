import torch

from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.learning.images.augment import Augment
from tests.learning.bundles import image_spec


def picture(batch=16):
    """A dot in each of two frames, on white."""
    image = torch.full((batch, 9, 9, 6), 255, dtype=torch.uint8)
    image[:, 4, 4] = 128
    return image


def test_without_ranges_images_are_darkened_alone():
    torch.testing.assert_close(Augment(0, 0.0)(picture()), ImageActor.darken(picture()))


def test_images_move_by_whole_pixels_at_most_the_shift_and_frames_together():
    torch.manual_seed(0)
    moved = Augment(2, 0.0)(picture(64))
    at = moved.flatten(2).argmax(2)
    assert (at == at[:, :1]).all()
    offsets = torch.stack([at[:, 0] // 9 - 4, at[:, 0] % 9 - 4], 1)
    assert offsets.abs().max() == 2
    assert len(set(map(tuple, offsets.tolist()))) > 3
    assert torch.allclose(moved.sum((1, 2, 3)), ImageActor.darken(picture(64)).sum((1, 2, 3)))


def test_colours_change_alike_in_all_frames_and_white_stays_white():
    torch.manual_seed(0)
    changed = Augment(0, 0.2)(picture(200))
    values = changed[:, :, 4, 4]
    assert torch.equal(values[:, :3], values[:, 3:])
    dot = 127 / 255
    assert values.min() >= 0.8 * dot - 1e-6
    assert values.max() <= 1.2 * dot + 1e-6
    assert values[:, 0].std() > 0.04
    changed[:, :, 4, 4] = 0.0
    assert not changed.any()


def test_as_images_white_stays_white_and_the_rest_is_what_is_darkened():
    torch.manual_seed(0)
    changed = Augment(0, 0.2)(picture())
    torch.manual_seed(0)
    images = Augment(0, 0.2).as_images(picture())
    assert images.dtype == torch.uint8
    assert images.shape == picture().shape
    torch.testing.assert_close(ImageActor.darken(images), changed, atol=0.5 / 255 + 1e-6, rtol=0)
    assert (images[:, 0] == 255).all()


def test_a_policy_sees_moved_images_and_factors_as_it_does_the_two_together():
    torch.manual_seed(0)
    changed = Augment(1, 0.3)(picture())
    torch.manual_seed(0)
    moved, factors = Augment(1, 0.3).drawn(picture())
    assert moved.dtype == torch.uint8
    torch.testing.assert_close(ImageActor.darken(moved) * factors[:, :, None, None], changed)
    actor = ImageActor(image_spec(9))
    with torch.no_grad():
        found = actor.state(moved, torch.zeros(16, 2), None, factors)
        plain = actor.state(moved, torch.zeros(16, 2))
        other = actor.state((255 * (1 - changed)).permute(0, 2, 3, 1), torch.zeros(16, 2))
    torch.testing.assert_close(found, other, atol=1e-6, rtol=1e-6)
    assert (plain - other).abs().max() > 1e-5
