# SPDX-License-Identifier: MIT
import pytest

from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions, TrainingOptions


@pytest.mark.parametrize(
    "values",
    [
        {"horizon": 6},
        {"actions": 16},
        {"sampling_steps": 101},
        {"kernel": 4},
        {"groups": 7},
        {"widths": ()},
        {"channels": (28,)},
    ],
)
def test_a_network_that_cannot_be_is_refused(values):
    with pytest.raises(ParameterError, match=next(iter(values))):
        NetworkOptions(**values)


@pytest.mark.parametrize("values", [{"updates": 0}, {"gain": -0.1}, {"average_most": 1.0}])
def test_a_training_that_cannot_be_is_refused(values):
    with pytest.raises(ParameterError, match=next(iter(values))):
        TrainingOptions(**values)
