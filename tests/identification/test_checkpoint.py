# SPDX-License-Identifier: MIT
from dataclasses import fields

import numpy as np
import pytest
import torch

from pinwm_drake.checkpoints import load_arrays, write_arrays
from pinwm_drake.errors import InputError
from pinwm_drake.identification.adam import AdamState
from pinwm_drake.identification.checkpoint import Checkpoint


def opened(folder, *, resume=True):
    return Checkpoint(folder, {}, resume=resume, every=1, size=3)


def test_a_phase_goes_on_where_it_was_interrupted(tmp_path):
    state = AdamState.at(torch.ones(2, 3, dtype=torch.float64))
    opened(tmp_path, resume=False).save_adam("screen", state)
    found = opened(tmp_path).load_adam("screen")
    for one in fields(AdamState):
        assert torch.equal(torch.as_tensor(getattr(found, one.name)), torch.as_tensor(getattr(state, one.name)))
    assert opened(tmp_path).load_adam("refine") is None


def test_a_scale_of_several_numbers_is_refused(tmp_path):
    checkpoint = opened(tmp_path, resume=False)
    checkpoint.save_adam("screen", AdamState.at(torch.ones(2, 3, dtype=torch.float64)))
    arrays, _ = load_arrays(checkpoint.path, "a checkpoint")
    write_arrays(checkpoint.path, {}, arrays | {"now.screen.scale": np.zeros(7)})
    with pytest.raises(InputError, match=r"now\.screen\.scale of float64 \(7,\)"):
        opened(tmp_path)


@pytest.mark.parametrize("name", [one.name for one in fields(AdamState)])
def test_a_phase_without_an_array_is_refused(tmp_path, name):
    checkpoint = opened(tmp_path, resume=False)
    checkpoint.save_adam("screen", AdamState.at(torch.ones(2, 3, dtype=torch.float64)))
    arrays, _ = load_arrays(checkpoint.path, "a checkpoint")
    del arrays[f"now.screen.{name}"]
    write_arrays(checkpoint.path, {}, arrays)
    with pytest.raises(InputError, match=rf": no array now\.screen\.{name}; allowed: a checkpoint of `identify`"):
        opened(tmp_path)


@pytest.mark.parametrize("bad", [np.nan, -np.inf])
def test_a_loss_may_be_infinite_but_not_nan(tmp_path, bad):
    checkpoint = opened(tmp_path, resume=False)
    checkpoint.end("coarse", {"z": np.zeros((2, 3)), "loss": np.array([0.1, np.inf])})
    assert opened(tmp_path).result("coarse")["loss"].tolist() == [0.1, np.inf]
    arrays, _ = load_arrays(checkpoint.path, "a checkpoint")
    write_arrays(checkpoint.path, {}, arrays | {"coarse.loss": np.array([0.1, bad])})
    with pytest.raises(InputError, match=r": got coarse\.loss with NaN or -inf; allowed: numbers, or infinity"):
        opened(tmp_path)


def test_an_array_of_another_name_is_refused(tmp_path):
    checkpoint = opened(tmp_path, resume=False)
    checkpoint.end("coarse", {"z": np.zeros((2, 3)), "loss": np.zeros(2)})
    arrays, _ = load_arrays(checkpoint.path, "a checkpoint")
    write_arrays(checkpoint.path, {}, arrays | {"extra": np.zeros(2)})
    with pytest.raises(InputError, match=r": got an array extra; allowed: a checkpoint of `identify`"):
        opened(tmp_path)
