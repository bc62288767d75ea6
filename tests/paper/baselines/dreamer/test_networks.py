import pytest
import torch

from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.baselines.dreamer.networks import Decoder, Encoder, layers


@pytest.mark.parametrize("size", [8, 16, 64])
def test_an_image_goes_in_and_one_of_its_size_comes_out(size):
    encoder, decoder = Encoder(size, 3, 4, 16), Decoder(20, size, 3, 4, 16)
    assert encoder(torch.zeros(5, 3, size, size), torch.zeros(5, 3)).shape == (5, encoder.size)
    image, pusher = decoder(torch.zeros(5, 20))
    assert image.shape == (5, 3, size, size)
    assert pusher.shape == (5, 3)


@pytest.mark.parametrize("size", [4, 48, 65])
def test_other_sizes_are_refused(size):
    with pytest.raises(ParameterError, match=str(size)):
        Encoder(size, 3, 4, 16)


def test_layers_have_the_widths_that_are_told():
    found = [tuple(one.weight.shape) for one in layers(3, 5, 2, 7) if isinstance(one, torch.nn.Linear)]
    assert found == [(5, 3), (5, 5), (7, 5)]
