# SPDX-License-Identifier: MIT
"""A proposed push in words and in files, for a cube whose friction is to be found."""

import dataclasses
import math

import numpy as np
import pytest
import torch
import yaml

from pinwm_drake.capture.episode_tables import read_trajectory
from pinwm_drake.experiments.next_push import Candidate, Proposal, trajectory_of
from pinwm_drake.experiments.proposal import describe, expectations, write_proposal
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.systems.pusher.motion import StraightPush
from tests.twin.samples import cube_twin

ONE = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
HERE = Pose(ONE, torch.zeros(3, dtype=torch.float64))


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    found = cube_twin(tmp_path_factory.mktemp("proposal"))
    friction = dataclasses.replace(found.theta["friction_floor"], value=0.2, interval=(0.1, 0.4))
    return dataclasses.replace(found, theta={**found.theta, "friction_floor": friction})


def proposal(*, y=0.0, direction=(1.0, 0.0, 0.0), remaining=0.5, tolerance=0.002):
    motion = StraightPush(np.array([-0.1, y, 0.0]), np.array(direction), 0.12, 0.1, 2.0)
    poses = Pose(ONE.repeat(4, 1), torch.zeros(4, 3, dtype=torch.float64))
    candidate = Candidate(motion, 8.7, 0.0031, math.radians(1.4), {"friction_floor": remaining}, poses)
    return Proposal([candidate], HERE, (tolerance, math.radians(2.0)))


def test_it_says_which_side_is_pushed_where_to_and_what_it_tells(twin):
    assert describe(twin, proposal(y=0.01)) == [
        "where the object comes to rest is predicted to 3.1 mm and 1.4° "
        "(standard deviation, nine of ten random pushes); good enough are 2 mm and 2°",
        "so a push is worth filming",
        "with the object at (0, 0) mm and yaw 0°, push the side that faces -x (180°): "
        "from (-100, 10, 0) mm towards +x (0°), for 100 mm at 120 mm/s",
        "the pusher passes 10 mm to the left of the centre of mass: the object turns clockwise, seen from above",
        "its video tells most about friction_floor: 95 % interval 0.1 to 0.4 now, about 0.141 to 0.283 afterwards",
        "the twin's draws differ by 3.1 mm and 1.4° in where it ends; 8.7 nats of information, "
        "the median of 1 pushes is 8.7",
    ]


def test_it_says_how_many_pushes_a_millimetre_decides(twin):
    one = proposal().candidates[0]
    last = dataclasses.replace(one, amplification=4.0)
    words = describe(twin, dataclasses.replace(proposal(), candidates=[one, one, last]))
    assert "1 of 3 pushes come last: a start that is off by a millimetre decides their end" in words
    assert not any("come last" in line for line in describe(twin, proposal()))


def test_other_pushes_have_other_words(twin):
    words = "; ".join(describe(twin, proposal(y=-0.01, remaining=0.95, tolerance=0.01)))
    assert "would hardly change what the twin predicts" in words
    assert "to the right of the centre of mass: the object turns anticlockwise" in words
    assert "narrow no parameter's interval by much" in words
    central = describe(twin, proposal())
    assert not any("centre of mass" in line for line in central)
    oblique = describe(twin, proposal(y=-0.1, direction=(math.sqrt(0.5), math.sqrt(0.5), 0.0)))
    assert "towards 45° (0° is +x, 90° is +y)" in oblique[2]
    missed = describe(twin, proposal(y=0.3))
    assert "faces -x (180°)" in missed[2]


def test_a_poke_has_words_of_its_own(twin):
    found = dataclasses.replace(proposal(direction=(0.8, 0.0, 0.6)), deciding="friction_floor")
    lines = describe(twin, found)
    assert "poke the side that faces -x (180°): from (-100, 0, 0) mm" in lines[2]
    assert "towards +x (0°) and 37° upwards, for 100 mm" in lines[2]
    assert "whether it turns over depends on friction_floor, which this poke tells best" in lines


def test_an_interval_shrinks_about_its_value(twin):
    (told,) = expectations(twin, proposal(remaining=0.5).candidates[0])
    assert told.after == pytest.approx((0.2 * math.sqrt(0.5), 0.2 * math.sqrt(2.0)))
    (same,) = expectations(twin, proposal(remaining=1.0).candidates[0])
    assert same.after == pytest.approx(same.interval)
    held = dataclasses.replace(twin.theta["friction_floor"], interval=None)
    without = dataclasses.replace(twin, theta={**twin.theta, "friction_floor": held})
    assert expectations(without, proposal().candidates[0]) == []


def test_files_tell_the_push_to_a_robot(twin, tmp_path):
    found = proposal()
    files = write_proposal(tmp_path, twin, found)
    assert [path.name for path in files] == ["push.yaml", "trajectory.csv", "next_push.png"]
    motion = found.candidates[0].motion
    document = yaml.safe_load(files[0].read_text())
    assert document["push"]["start"] == pytest.approx(motion.p_WP.tolist())
    assert math.hypot(*document["push"]["direction"][:2]) == pytest.approx(1.0)
    (told,) = document["expected"]
    assert told["parameter"] == "friction_floor"
    assert told["interval"] == [0.1, 0.4]
    read = read_trajectory(tmp_path)
    expected = trajectory_of(motion)
    assert read.p_WP == pytest.approx(expected.p_WP, abs=1e-9)
    assert np.linalg.norm(read.v_WP, axis=1).max() == pytest.approx(motion.speed)
    assert np.linalg.norm(read.p_WP[-1] - read.p_WP[0]) == pytest.approx(motion.distance)
    assert files[2].stat().st_size > 10_000
