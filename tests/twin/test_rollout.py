# SPDX-License-Identifier: MIT
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import SolverError
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin import rollout as module
from pinwm_drake.twin.origin import in_push
from pinwm_drake.twin.rollout import drawn_parameters, rollout, twin_parameters, twin_scene
from pinwm_drake.twin.twin import Draws, Estimate
from tests.capture.cube import SIDE
from tests.report.samples import GAP, SPEED, log
from tests.twin.samples import cube_twin, estimates

LEVEL = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
START = Pose(LEVEL, torch.tensor([0.0, 0.0, SIDE / 2], dtype=torch.float64))


@pytest.fixture
def twin(tmp_path):
    values = {"restitution_floor": 0.0, "restitution_pusher": 0.0, "friction_floor": 0.5}
    shape = PusherGeometry(None, PusherShape("capsule", 0.01, 0.04))
    return cube_twin(tmp_path, theta=estimates(**values), pusher=shape)


def test_parameters_are_those_of_the_twin(twin):
    parameters = twin_parameters(twin, twin_scene(twin, LEVEL))
    assert float(parameters.mass) == twin.theta["mass"].value
    wanted = [twin.theta[f"inertia_{axis}"].value for axis in ("xx", "yy", "zz")]
    assert parameters.inertia[0, 0].diagonal().tolist() == pytest.approx(wanted)
    assert parameters.friction[0].tolist() == [twin.theta["friction_floor"].value, twin.theta["friction_pusher"].value]


def test_the_cube_is_where_the_pusher_puts_it(twin):
    t = 0.1 * np.arange(5)
    poses = rollout(twin, START, log(5), t)
    # A step of the physics is 0.4 mm of its way.
    assert np.allclose(poses.p_WO[:, 0], np.maximum(SPEED * t - GAP, 0.0), atol=5e-4)


def test_a_start_above_the_floor_falls(twin):
    high = Pose(LEVEL, torch.tensor([0.3, 0.0, SIDE / 2 + 0.1], dtype=torch.float64))
    poses = rollout(twin, high, log(3), np.array([0.0, 0.1, 0.2]))
    assert poses.p_WO[1, 2] == pytest.approx(SIDE / 2 + 0.1 - 0.5 * 9.81 * 0.01, abs=3e-3)


def test_smaller_steps_help_out_and_a_lasting_failure_is_told(twin, monkeypatch):
    original, seen = module.rollout_worlds, []

    def failing(scene, *arguments, worst, **named):
        seen.append(scene.model.time_step)
        if scene.model.time_step > worst:
            raise SolverError("the contact LCP found no solution")
        return original(scene, *arguments, **named)

    monkeypatch.setattr(module, "rollout_worlds", partial(failing, worst=twin.time_step / 3))
    assert len(rollout(twin, START, log(3), np.array([0.0, 0.1])).t) == 2
    assert seen == [twin.time_step, twin.time_step / 2, twin.time_step / 4]
    monkeypatch.setattr(module, "rollout_worlds", partial(failing, worst=0.0))
    with pytest.raises(SolverError, match="no solution"):
        rollout(twin, START, log(3), np.array([0.0, 0.1]))


def test_draws_of_a_push_have_frictions_of_their_own(twin):
    rows = np.arange(2000)
    names = ["friction_floor", "friction_pusher", "mass"]
    drawn = replace(twin, draws=Draws(names, np.tile([0.3, 0.2, 1.0], (len(rows), 1))))
    scene = twin_scene(twin, LEVEL)
    parameters = drawn_parameters(drawn, scene, rows)
    ratios = (parameters.friction / torch.tensor([0.3, 0.2], dtype=torch.float64)).log()
    assert ratios.std(0).tolist() == pytest.approx([0.05, 0.2], rel=0.1)
    assert ratios.mean(0).tolist() == pytest.approx([0.0, 0.0], abs=0.01)
    assert torch.equal(parameters.mass, torch.ones_like(parameters.mass))
    assert torch.equal(drawn_parameters(drawn, scene, rows).friction, parameters.friction)


def test_a_push_that_was_seen_has_the_frictions_that_it_had(twin):
    grips = {"grip_floor.0": 1.1, "grip_pusher.0": 0.9, "grip_floor.1": 0.8, "grip_pusher.1": 1.0}
    nuisance = twin.nuisance | {name: Estimate(value, None, True, "1") for name, value in grips.items()}
    several = replace(twin, nuisance=nuisance, draws=Draws(["mass", "friction_floor"], np.array([[1.0, 0.3]])))
    floor, pusher = (twin.theta[f"friction_{one}"].value for one in ("floor", "pusher"))
    for push, wanted in ((0, (1.1 * floor, 0.9 * pusher)), (1, (0.8 * floor, pusher)), (None, (floor, pusher))):
        found = in_push(several, push)
        assert [found.theta[f"friction_{one}"].value for one in ("floor", "pusher")] == pytest.approx(wanted)
        assert found.draws.values[0].tolist() == pytest.approx([1.0, 0.3 * wanted[0] / floor])
