# SPDX-License-Identifier: MIT
"""Tables of measured poses in their three forms, and their refusals."""

import math

import numpy as np
import pytest
import torch

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.capture.measured_poses import read_measured_poses, within_log
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.poses import Pose

UP = Pose(torch.tensor([1.0, 0.0, 0.0, 0.0]).double(), torch.tensor([0.3, 0.0, 0.25]).double())
# On its side: x of O stays level, and points along the world's y.
SIDE = Pose(torch.tensor([0.5, 0.5, 0.5, 0.5]).double(), UP.p)


def written(folder, text):
    path = folder / "poses.csv"
    path.write_text(text)
    return path


def test_whole_poses_are_read_by_either_name_of_their_columns(tmp_path):
    for header in ("t,px,py,pz,qw,qx,qy,qz", "t,x,y,z,qw,qx,qy,qz"):
        found = read_measured_poses(written(tmp_path, f"{header}\n0,1,2,3,1,0,0,0\n0.5,1,2,4,0,0,0,1\n"), UP)
        assert not found.planar
        assert found.poses.p_WO.tolist() == [[1, 2, 3], [1, 2, 4]]
        assert found.poses.q_WO[1].tolist() == [0, 0, 0, 1]
        assert found.lines == [2, 3]


@pytest.mark.parametrize("rest", [UP, SIDE])
def test_planar_poses_take_height_and_tilt_from_the_object_at_rest(tmp_path, rest):
    found = read_measured_poses(written(tmp_path, "t,x,y,yaw\n0,1,2,0\n0.5,1,2,1.2\n"), rest)
    assert found.planar
    assert found.poses.p_WO[1].tolist() == [1, 2, 0.25]
    w, x, y, z = found.poses.q_WO[1]
    heading = math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))  # of x of O
    assert heading == pytest.approx(1.2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,x,y\n0,1,2\n", "row 1: got t,x,y; allowed: columns t,px,py,pz,qw,qx,qy,qz or "),
        ("t,x,y,yaw\n0,1,2,0\n0.1,1,nan,0\n", "row 3: got y = nan; allowed: a finite number"),
        ("t,x,y,yaw\n0,1,2,0\n0,1,2,0\n", "row 3: got t = 0; allowed: a time after 0 s"),
        ("t,px,py,pz,qw,qx,qy,qz\n0,1,2,3,1,1,0,0\n1,1,2,3,1,0,0,0\n", "row 2: got qw, qx, qy, qz ="),
        ("t,x,y,yaw\n0,1,2,0\n", "got 1 row; allowed: 2 or more"),
    ],
)
def test_a_bad_table_is_refused_in_one_line(tmp_path, text, message):
    with pytest.raises(InputError) as error:
        read_measured_poses(written(tmp_path, text), UP)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_rows_outside_of_the_log_are_counted_and_a_table_of_another_clock_is_refused(tmp_path):
    t = np.array([0.0, 1.0])
    log = PusherTrajectory(t, np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.zeros((2, 3)), None)
    path = written(tmp_path, "t,x,y,yaw\n-0.5,1,2,0\n0,1,2,0\n0.5,1,2,0\n1.5,1,2,0\n")
    found = within_log(read_measured_poses(path, UP), log)
    assert (found.poses.t.tolist(), found.lines, found.left_out) == ([0, 0.5], [3, 4], 2)
    late = written(tmp_path, "t,x,y,yaw\n1700000000,1,2,0\n1700000001,1,2,0\n")
    with pytest.raises(InputError, match="is it another clock"):
        within_log(read_measured_poses(late, UP), log)
