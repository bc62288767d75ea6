# SPDX-License-Identifier: MIT
"""Impulses of a rollout's contacts against those of single steps, and against what moves the bodies."""

import numpy as np
import pytest

from pinwm_drake.errors import StateError
from pinwm_drake.physics.diagnose import inspect
from pinwm_drake.physics.impulses import contact_impulses
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.stepper import Stepper
from tests.physics.scenes import push_model, push_start, straight_push

STEPS = 60


@pytest.fixture(scope="module")
def rolled():
    model = push_model(time_step=1 / 240)
    parameters = Parameters.nominal(model, friction_floor=0.2, friction_pusher=0.3, num_worlds=2)
    V_WP = straight_push(STEPS, 2)
    record = Stepper(model, num_threads=1).rollout(parameters, push_start(model, 2), V_WP)
    return model, parameters, record, V_WP, contact_impulses(model, parameters, record, V_WP, num_threads=1)


def test_impulses_are_those_of_each_step(rolled):
    model, parameters, record, V_WP, impulses = rolled
    assert impulses.shape == (STEPS, 2, len(model.pair_names), 3)
    for step in (0, 15, STEPS - 1):
        one = inspect(model, parameters, record.frame(step), V_WP[step], world=1)
        for column, name in enumerate(model.pair_names):
            mine = [k for k, pair in enumerate(one.pair) if pair == name]
            np.testing.assert_allclose(impulses[step, 1, column], one.impulse_W[mine].sum(0), atol=1e-9)


def test_impulses_are_the_change_of_momentum(rolled):
    model, parameters, record, _, impulses = rolled
    gained = float(parameters.mass[0, 0]) * np.diff(record.V_WB[:, :, 0, 3:].numpy(), axis=0)
    weight = float(parameters.mass[0, 0]) * np.array(model.gravity) * model.time_step
    # The solver stops at 1e-10 of its scale; the pusher gives some 1e-2 N s a step.
    np.testing.assert_allclose(impulses.sum(2) + weight, gained, atol=1e-7)
    assert np.abs(impulses[-1, 0, 1]).max() > 1e-3


def test_frames_have_to_fit_the_steps(rolled):
    model, parameters, record, V_WP, _ = rolled
    with pytest.raises(StateError, match="V_WP"):
        contact_impulses(model, parameters, record, V_WP[1:])
