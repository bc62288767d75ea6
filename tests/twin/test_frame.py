# SPDX-License-Identifier: MIT
"""The robot's frame: how it moves a log, and when draws do not tell it from the centre of mass."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.scene import pusher_motion
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_exp, rotate, turn_between
from pinwm_drake.twin.frame import confusion, drawn_frames, in_world, moved_motion, pivot_of
from pinwm_drake.twin.rollout import rollout, rollout_draws
from pinwm_drake.twin.twin import Draws, Estimate
from tests.twin.samples import cube_twin

LEVEL = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
FRAME = {"frame_x": 0.004, "frame_y": -0.003, "frame_yaw": 0.2}
PIVOT = [0.1, 0.05, 0.03]


def log() -> PusherTrajectory:
    t = np.linspace(0.0, 0.4, 30)
    p = np.stack([-0.06 + 0.2 * t, 0.01 + 0.0 * t, 0.03 + 0.0 * t], -1)
    turn = np.stack([np.cos(0.3 * t), 0 * t, 0 * t, np.sin(0.3 * t)], -1)
    force = np.tile([1.0, 0.5, 0.2], (len(t), 1))
    return PusherTrajectory(t, p, turn, np.tile([0.2, 0.0, 0.0], (len(t), 1)), force)


def framed(folder):
    """A twin of a cube with a frame about a pivot."""
    twin = cube_twin(folder, provenance={"start": {"written": {"p": PIVOT, "q": [1, 0, 0, 0]}}})
    frame = {name: Estimate(value, None, True, "m") for name, value in FRAME.items()}
    return replace(twin, nuisance=twin.nuisance | frame)


def test_a_log_turns_about_the_pivot_and_then_moves(tmp_path):
    moved = in_world(framed(tmp_path), log())
    turn = quaternion_exp(torch.tensor([0.0, 0.0, FRAME["frame_yaw"]], dtype=torch.float64))
    pivot, shift = torch.tensor([PIVOT, [0.004, -0.003, 0.0]], dtype=torch.float64)
    expected = rotate(turn, torch.from_numpy(log().p_WP) - pivot) + pivot + shift
    np.testing.assert_allclose(moved.p_WP, expected.numpy(), atol=1e-12)
    np.testing.assert_allclose(
        moved.force_W[0], rotate(turn, torch.tensor([1.0, 0.5, 0.2], dtype=torch.float64)).numpy()
    )
    turn = turn_between(torch.from_numpy(log().q_WP[3]), torch.from_numpy(moved.q_WP[3]))
    assert float(turn[2]) == pytest.approx(0.2)
    assert pivot_of(cube_twin(tmp_path)).tolist() == [0.0, 0.0, 0.0]


def test_a_motion_that_is_moved_is_that_of_the_log_that_is_moved(tmp_path):
    twin, h = framed(tmp_path), 1 / 240
    plain = pusher_motion(log(), 0.0, 60, h)
    frame = torch.tensor([list(FRAME.values())], dtype=torch.float64)
    found, expected = moved_motion(plain, frame, pivot_of(twin)), pusher_motion(in_world(twin, log()), 0.0, 60, h)
    torch.testing.assert_close(found.p_WP[0], expected.p_WP)
    torch.testing.assert_close(found.q_WP[0], expected.q_WP)
    torch.testing.assert_close(found.V_WP[:, 0], expected.V_WP, atol=1e-9, rtol=0.0)


def test_draws_are_rolled_out_each_with_its_own_frame(tmp_path):
    twin = framed(tmp_path)
    values = {name: [one.value, one.value] for name, one in twin.theta.items()} | {"frame_y": [-0.003, 0.012]}
    drawn = replace(twin, draws=Draws(list(values), np.array(list(values.values())).T))
    rows, t = np.array([0, 1]), np.array([0.0, 0.2, 0.4])
    assert drawn_frames(drawn, rows).tolist() == [[0.004, -0.003, 0.2], [0.004, 0.012, 0.2]]
    start = Pose(LEVEL, torch.tensor([0.0, 0.0, 0.03], dtype=torch.float64))
    found = rollout_draws(drawn, start, log(), t, rows)
    for row in rows.tolist():
        same = replace(drawn, draws=replace(drawn.draws, values=drawn.draws.values[[row, row]]))
        np.testing.assert_allclose(found.p[:, row], rollout_draws(same, start, log(), t, rows).p[:, row], atol=1e-9)
    assert not np.allclose(found.p[-1, 0], found.p[-1, 1], atol=1e-4)
    by_log, by_frame = (rollout(twin, start, one, t).p_WO[-1] for one in (log(), in_world(twin, log())))
    assert not np.allclose(by_log, by_frame, atol=1e-4)


@pytest.mark.parametrize("angle", [0.0, 70.0, 130.0])
def test_draws_that_go_together_along_a_direction_are_named(angle):
    generator, number = np.random.default_rng(0), 400
    u = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    common = 0.003 * generator.normal(size=(number, 1)) * u
    frame = common + 2e-4 * generator.normal(size=(number, 2))
    turn = quaternion_exp(torch.tensor([0.0, 0.0, 0.5], dtype=torch.float64))
    center_W = np.pad(common + 2e-4 * generator.normal(size=(number, 2)), ((0, 0), (0, 1)))
    center_O = rotate(turn * torch.tensor([1, -1, -1, -1]), torch.from_numpy(center_W)).numpy()
    names = ["frame_x", "frame_y", "center_x", "center_y", "center_z"]
    found = confusion(Draws(names, np.concatenate([frame, center_O], -1)), turn)
    assert found is not None
    assert abs((math.degrees(found.angle) - angle + 90.0) % 180.0 - 90.0) <= 15.0
    assert found.correlation > 0.95
    assert found.spread == pytest.approx(0.003, rel=0.2)
    apart = np.concatenate([frame, generator.permutation(center_O)], -1)
    assert confusion(Draws(names, apart), turn) is None
    assert confusion(None, turn) is None
