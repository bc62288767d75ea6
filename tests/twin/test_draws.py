# SPDX-License-Identifier: MIT
"""Draws of a twin: their file, and the spread of predictions that follows from them."""

import dataclasses

import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_exp
from pinwm_drake.twin.drift import DRIFT, DRIFT_TURN, DRIFTS, drift, typical_drift, way
from pinwm_drake.twin.kicks import OF_HITS, PER_WALK, Kicks
from pinwm_drake.twin.predict import mean_pose, spread_of
from pinwm_drake.twin.read import load_twin, read_draws
from pinwm_drake.twin.twin import DRAWS_FILE, Draws
from pinwm_drake.twin.write import write_draws, write_twin
from tests.twin.samples import cube_twin


def draws():
    return Draws(["friction_floor", "support_x"], np.array([[0.1, 1.0], [0.2, 1.5], [0.3, 0.7]]))


def test_draws_go_to_a_twin_and_back(tmp_path):
    twin = dataclasses.replace(cube_twin(tmp_path / "first"), draws=draws())
    write_twin(tmp_path / "second", twin)
    again = load_twin(tmp_path / "second").draws
    assert again.names == draws().names
    assert np.array_equal(again.values, draws().values)
    assert again.column("support_x").tolist() == [1.0, 1.5, 0.7]
    # They belong to the twin as its meshes do.
    write_draws(tmp_path / "second" / DRAWS_FILE, Draws(["mass"], np.ones((2, 1))))
    with pytest.raises(InputError, match=r"draws\.npz: got SHA-256"):
        load_twin(tmp_path / "second")


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"names": np.array(["a"])}, r"got arrays \['names'\]"),
        ({"names": np.array(["a"]), "values": np.ones((3, 2))}, r"names \(1,\), values \(3, 2\)"),
        ({"names": np.array(["a"]), "values": np.ones((0, 1))}, "N > 0"),
        ({"names": np.array(["a", "b"]), "values": np.array([[1.0, 2.0], [1.0, np.nan]])}, "nan in row 1 of b"),
    ],
)
def test_broken_draws_are_refused(tmp_path, arrays, message):
    np.savez(tmp_path / "draws.npz", **arrays)
    with pytest.raises(InputError, match=message):
        read_draws(tmp_path / "draws.npz")


def test_way_counts_turns_by_the_rim_and_times_in_any_order():
    angle = torch.tensor([0.0, 0.2, 0.5], dtype=torch.float64)
    q = quaternion_exp(torch.stack([0 * angle, 0 * angle, angle], -1))
    p = torch.tensor([[0.0, 0.0, 0.0], [0.03, 0.04, 0.0], [0.03, 0.04, 0.0]], dtype=torch.float64)
    times, order = torch.tensor([0.0, 1.0, 2.0]), torch.tensor([2, 0, 1])
    expected = torch.tensor([0.0, 0.05 + 0.1 * 0.2, 0.05 + 0.1 * 0.5], dtype=torch.float64)
    torch.testing.assert_close(way(Pose(q, p), times, 0.1), expected)
    torch.testing.assert_close(way(Pose(q[order], p[order]), times[order], 0.1), expected[order])


def test_spread_is_that_of_the_draws_and_of_the_drift(tmp_path):
    twin = cube_twin(tmp_path)
    W, n = 4000, 3
    generator = np.random.default_rng(0)
    x = np.array([0.0, 0.05, 0.1])[:, None] * (1.0 + 0.1 * generator.normal(size=W))
    p = np.stack([x, np.zeros((n, W)), np.zeros((n, W))], -1)
    q = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64).expand(n, W, 4)
    spread = spread_of(Pose(q, torch.from_numpy(p)), np.array([0.0, 0.5, 1.0]), twin)
    walked = DRIFTS[0][0] * np.sqrt(np.array([0.0, 0.05, 0.1]))
    assert spread.y == pytest.approx(walked, rel=0.02)
    assert spread.x == pytest.approx(np.hypot(walked, [0.0, 0.005, 0.01]), rel=0.05)
    slides, hits = torch.zeros(n * 6, 2, dtype=torch.float64), torch.zeros(n * 6, 1, dtype=torch.float64)
    slides[2 * 6 + 4] = torch.tensor([3.0, 4.0], dtype=torch.float64)
    hits[2 * 6 + 4] = 0.1
    more = spread_of(Pose(q, torch.from_numpy(p)), np.array([0.0, 0.5, 1.0]), twin, Kicks(slides, hits))
    errors = np.hypot(5.0 * PER_WALK * DRIFTS[0][0], 0.1 * OF_HITS)
    assert more.y[-1] == pytest.approx(np.hypot(spread.y[-1], errors))
    assert more.x == pytest.approx(spread.x)
    assert more.yaw == pytest.approx(spread.yaw)
    assert float(DRIFTS[0][0] / drift(0.05, *DRIFTS[0])[2]) == pytest.approx(0.05)
    assert spread.position[-1] == pytest.approx(np.hypot(spread.x[-1], spread.y[-1]))


def test_a_twin_drifts_as_its_draws_do(tmp_path):
    twin = cube_twin(tmp_path)
    assert typical_drift(twin) == DRIFTS[0]
    draws = Draws([DRIFT], np.array([[3e-3], [4e-3], [0.0], [0.0]]))
    assert typical_drift(dataclasses.replace(twin, draws=draws)) == pytest.approx((2.5e-3, 1.0))
    turning = Draws([DRIFT, DRIFT_TURN], np.array([[3e-3, 2.0], [4e-3, 2.0], [0.0, 9.0], [0.0, 9.0]]))
    assert typical_drift(dataclasses.replace(twin, draws=turning)) == pytest.approx((2.5e-3, 2.0))


def test_the_mean_of_poses_is_in_the_middle_of_their_turns():
    angle = torch.tensor([[3.0, 3.2, 3.4], [0.1, -0.1, 0.3]], dtype=torch.float64)
    q = quaternion_exp(torch.stack([0 * angle, 0 * angle, angle], -1))
    p = torch.arange(18, dtype=torch.float64).reshape(2, 3, 3)
    found = mean_pose(Pose(q * torch.tensor([1.0, -1.0, 1.0])[:, None], p))
    torch.testing.assert_close(found.p, p.mean(1))
    expected = quaternion_exp(torch.tensor([[0.0, 0.0, 3.2], [0.0, 0.0, 0.1]], dtype=torch.float64))
    torch.testing.assert_close((found.q * expected).sum(-1).abs(), torch.ones(2, dtype=torch.float64))
