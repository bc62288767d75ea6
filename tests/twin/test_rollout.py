import numpy as np
import pytest
import torch

from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import SolverError
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin import rollout as module
from pinwm_drake.twin.rollout import rollout, twin_parameters, twin_scene
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
    original, seen = module._rollout, []

    def failing(twin, *arguments, worst):
        seen.append(twin.time_step)
        if twin.time_step > worst:
            raise SolverError("the contact LCP found no solution")
        return original(twin, *arguments)

    monkeypatch.setattr(module, "_rollout", lambda *arguments: failing(*arguments, worst=twin.time_step / 3))
    assert len(rollout(twin, START, log(3), np.array([0.0, 0.1])).t) == 2
    assert seen == [twin.time_step, twin.time_step / 2, twin.time_step / 4]
    monkeypatch.setattr(module, "_rollout", lambda *arguments: failing(*arguments, worst=0.0))
    with pytest.raises(SolverError, match="no solution"):
        rollout(twin, START, log(3), np.array([0.0, 0.1]))
