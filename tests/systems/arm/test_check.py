# SPDX-License-Identifier: MIT
"""The check of arms: slow motions are followed, those beyond an arm's acceleration are not."""

import dataclasses

import numpy as np
import pytest

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.contract import FOLLOWED, ArmCheck
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.systems.arm.check import ToolMotion, check_arm
from tests.systems.stations import action_setup

LIMITS = SafetyLimits((-0.3, -0.3, 0.015), (0.3, 0.3, 0.035), 0.2, 4.0, 0.2)
# m/s, of actions of 0.1 s: there and back, across.
ZIGZAG = np.array([[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, -0.1, 0.0]])


@pytest.fixture(scope="module")
def setup():
    return action_setup("push_t", image_size=32)


def motion(v_WP, x=0.0):
    return ToolMotion(np.array([x, -0.1, 0.025]), np.asarray(v_WP, float), 0.1)


@pytest.mark.parametrize("arm", ["iiwa", "panda"])
def test_a_slow_way_is_followed(setup, arm):
    found = check_arm(arm, setup, LIMITS, [motion(np.tile([0.05, 0.0, 0.0], (6, 1)))])
    assert found.follows
    assert 0.0 < found.error < 0.1
    assert found.reason == "its limits are no less than the policy's"
    assert f"{found}".startswith(f"{found.title} follows the policy: the way of an action is off by ")


def test_turns_beyond_the_arms_acceleration_are_not_followed(setup):
    # With 40 m/s^2 a pusher of 0.1 m/s turns round within 5 ms; with 4 m/s^2 that takes half of an action.
    fast = dataclasses.replace(LIMITS, max_acceleration=40.0)
    found = check_arm("iiwa", setup, fast, [motion(ZIGZAG), motion(ZIGZAG)])
    assert not found.follows
    assert 0.3 < found.error < 1.0
    assert found.reason == "max_acceleration: 4 of 40 m/s^2"
    assert check_arm("iiwa", setup, LIMITS, [motion(ZIGZAG)]).error < found.error


def test_places_out_of_reach_are_left_out_and_told_where_there_are_no_others(setup):
    slow = np.tile([0.0, 0.05, 0.0], (3, 1))
    far = motion(slow, x=0.34)
    found = check_arm("iiwa", setup, LIMITS, [far])
    assert (found.follows, found.error) == (False, None)
    assert "out of the arm's reach" in found.reason
    assert check_arm("iiwa", setup, LIMITS, [far, motion(slow)]).follows


def test_a_scene_out_of_reach_is_told(setup):
    pusher = dataclasses.replace(setup.scenario.pusher, low=(0.3, -0.3, 0.0), high=(0.4, 0.3, 0.1))
    far = dataclasses.replace(setup, scenario=dataclasses.replace(setup.scenario, pusher=pusher))
    found = check_arm("iiwa", far, LIMITS, [motion(ZIGZAG, x=0.35)])
    assert (found.follows, found.error) == (False, None)
    assert "box_low, box_high" in found.reason


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"follows": True}, "follows: got True with error 0.5; allowed: False"),
        ({"error": -0.1}, "error: got -0.1"),
        ({"error": None, "follows": True}, "follows: got True with error None; allowed: False"),
        ({"error": float("nan")}, "error"),
        ({"speed": 1}, "speed"),
        ({"title": None}, "title"),
    ],
)
def test_a_check_that_contradicts_itself_is_refused(changes, message):
    document = {"arm": "iiwa", "title": "KUKA", "follows": False, "error": 0.5, "reason": "slow"}
    assert ArmCheck.from_document(document).error > FOLLOWED
    with pytest.raises(ParameterError, match=message):
        ArmCheck.from_document(document | changes)
