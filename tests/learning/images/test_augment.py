# SPDX-License-Identifier: MIT
import torch

from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.learning.images.augment import Augment


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
    assert values.min() >= 0.8 * dot - 0.002
    assert values.max() <= 1.2 * dot + 0.002
    assert values[:, 0].std() > 0.04
    changed[:, :, 4, 4] = 0.0
    assert not changed.any()


def test_as_images_they_are_what_is_darkened_in_a_call():
    torch.manual_seed(0)
    changed = Augment(1, 0.2)(picture())
    torch.manual_seed(0)
    images = Augment(1, 0.2).as_images(picture())
    assert images.dtype == torch.uint8
    torch.testing.assert_close(ImageActor.darken(images), changed)
    assert (images[:, 0] == 255).all()


def square(batch=400, frames=2):
    """A square of 20 px in each of some frames, on white."""
    image = torch.full((batch, 40, 40, 3 * frames), 255, dtype=torch.uint8)
    image[:, 10:30, 10:30] = 100
    return image


def test_masks_are_too_small_or_too_large_along_their_outline_alone():
    torch.manual_seed(0)
    image = square()
    changed = Augment(0, 0.0, 1.0).as_images(image)
    assert torch.equal(image, square())  # it is not changed in place
    assert (changed[:, 11:29, 11:29] == 100).all()
    assert (changed[:, :9] == 255).all()
    assert (changed[:, 9, [9, 30]] == 255).all()  # beside the object is above, below, left and right of it
    inner = (changed.view(400, 40, 40, 2, 3) != 255).any(-1).sum((1, 2))  # (batch, frames)
    smaller, larger = inner < 400, inner > 400
    assert inner.min() >= 400 - 76
    assert inner.max() <= 400 + 80
    assert 0.35 < smaller.float().mean() < 0.65
    assert 0.35 < larger.float().mean() < 0.65
    wrong = torch.where(smaller, (400 - inner) / 76.0, (inner - 400) / 80.0)
    assert wrong.max() > 0.8
    assert (inner[:, 0] != inner[:, 1]).float().mean() > 0.8  # frames differ
    assert ((inner[:, 0] - inner[:, 1]).abs() <= 80 * (2 / 3 + 0.3)).all()  # by shares of up to two thirds, and chance


def test_masks_are_wrong_by_no_more_than_is_allowed():
    torch.manual_seed(0)
    changed = Augment(0, 0.0, 0.25).as_images(square())
    inner = (changed.view(400, 40, 40, 2, 3) != 255).any(-1).sum((1, 2))
    assert 400 - 76 * 0.5 < inner.min() < 390
    assert 410 < inner.max() < 400 + 80 * 0.5


def test_what_is_seen_beside_an_object_has_one_colour_a_stack():
    torch.manual_seed(0)
    changed = Augment(0, 0.0, 1.0).as_images(square()).view(400, 40, 40, 2, 3)
    outside = torch.ones(40, 40, dtype=torch.bool)
    outside[10:30, 10:30] = False
    colours = []
    for stack in changed:
        seen = stack[outside].reshape(-1, 3)
        seen = seen[(seen != 255).any(-1)]
        assert (seen == seen[:1]).all()
        colours += seen[:1].tolist()
    assert len({tuple(colour) for colour in colours}) > 100
