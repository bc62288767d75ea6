from dataclasses import replace

import numpy as np
import pytest

from pinwm_drake.experiments.one_step import one_step_errors
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.twin import write_twin


def test_a_twin_of_the_true_theta_has_no_error_and_another_one_has(tmp_path):
    setup = load_setup("push_t")
    write_twin(tmp_path / "true", setup.twin)
    write_twin(tmp_path / "rough", setup.with_theta(friction_pusher=0.8).twin)
    same = one_step_errors("push_t", str(tmp_path / "true"), "twin", 3, 0)
    assert same.shape == (3, 2)
    assert np.abs(same).max() < 1e-9
    assert one_step_errors("push_t", str(tmp_path / "rough"), "twin", 3, 0).max() > 1e-4


def test_a_twin_whose_floor_is_lower_begins_there(tmp_path):
    twin = load_setup("push_t").twin
    lower = replace(twin, floor_height=twin.floor_height - 0.004)
    write_twin(tmp_path / "lower", lower)
    found = one_step_errors("push_t", str(tmp_path / "lower"), "twin", 2, 0)
    assert found[:, 0] == pytest.approx(0.0, abs=2e-3)  # a pusher that meets it 4 mm higher; no fall
