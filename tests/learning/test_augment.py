import torch

from pinwm_drake.learning.augment import Augment


def picture(batch=16):
    """A dot in each of two frames, 0 for white."""
    dark = torch.zeros(batch, 6, 9, 9)
    dark[:, :, 4, 4] = 0.5
    return dark


def test_without_ranges_nothing_changes():
    assert torch.equal(Augment(0, 0.0)(picture()), picture())


def test_images_move_by_whole_pixels_at_most_the_shift_and_frames_together():
    torch.manual_seed(0)
    moved = Augment(2, 0.0)(picture(64))
    at = moved.flatten(2).argmax(2)
    assert (at == at[:, :1]).all()
    offsets = torch.stack([at[:, 0] // 9 - 4, at[:, 0] % 9 - 4], 1)
    assert offsets.abs().max() == 2
    assert len(set(map(tuple, offsets.tolist()))) > 3
    assert torch.allclose(moved.sum((1, 2, 3)), picture(64).sum((1, 2, 3)))


def test_colours_change_alike_in_all_frames_and_white_stays_white():
    torch.manual_seed(0)
    changed = Augment(0, 0.2)(picture(200))
    values = changed[:, :, 4, 4]
    assert torch.equal(values[:, :3], values[:, 3:])
    assert values.min() >= 0.4
    assert values.max() <= 0.6
    assert values[:, 0].std() > 0.04
    changed[:, :, 4, 4] = 0.0
    assert not changed.any()
