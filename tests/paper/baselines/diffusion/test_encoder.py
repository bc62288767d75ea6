import pytest
import torch

from pinwm_drake.paper.baselines.diffusion.encoder import ImageEncoder, spatial_softmax
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions


def test_the_place_of_a_peak_is_found():
    maps = torch.full((2, 3, 5, 9), -50.0)
    maps[0, 1, 4, 2] = 50.0  # row 4 of 0 to 4, column 2 of 0 to 8
    maps[1, 2, 1, 8] = 50.0
    places = spatial_softmax(maps)
    assert places.shape == (2, 3, 2)
    assert places[0, 1].tolist() == pytest.approx([-0.5, 1.0], abs=1e-6)
    assert places[1, 2].tolist() == pytest.approx([1.0, -0.5], abs=1e-6)
    assert places[0, 0].tolist() == pytest.approx([0.0, 0.0], abs=1e-6)  # an even map: its middle


def test_a_side_of_one_pixel_has_its_place_in_the_middle():
    assert torch.equal(spatial_softmax(torch.randn(1, 2, 1, 1)), torch.zeros(1, 2, 2))


@pytest.mark.parametrize("size", [16, 32, 64])
def test_images_of_any_size_become_features(size):
    encoder = ImageEncoder(NetworkOptions(channels=(8, 16), keypoints=5, image_features=12))
    features = encoder(torch.rand(3, 3, size, size))
    assert features.shape == (3, 12)
    features.sum().backward()
    assert all(one.grad is not None for one in encoder.parameters())
