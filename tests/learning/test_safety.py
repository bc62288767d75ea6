# SPDX-License-Identifier: MIT
import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.contract import make_contract
from pinwm_drake.learning.safety import SafetyLimits, default_limits
from pinwm_drake.learning.spec import CameraSpec, PolicySpec
from pinwm_drake.tasks.push import PushTask

GIVEN = {
    "box_low": (-0.3, -0.2, 0.01),
    "box_high": (0.3, 0.2, 0.05),
    "max_speed": 0.2,
    "max_acceleration": 4.0,
    "max_image_age": 0.1,
}


def limits(**changes):
    return SafetyLimits(**(GIVEN | changes))


def test_limits_survive_yaml():
    given = limits(box_tolerance=0.002, max_command_age=0.3, max_lag=0.01)
    document = yaml.safe_load(yaml.safe_dump(given.to_document()))
    assert SafetyLimits.from_document(document) == given
    assert set(document) == {field.name for field in dataclasses.fields(SafetyLimits)}


def test_numpy_numbers_become_plain_ones():
    made = limits(box_low=np.array([-0.3, -0.2, 0.01]), box_high=[0.3, 0.2, 0.05], max_speed=np.float64(0.2), max_lag=1)
    assert made == limits(max_lag=1.0)
    assert all(type(value) is float for value in (*made.box_low, made.max_speed, made.max_lag))


def test_limits_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        limits().max_speed = 10.0


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 0.0, -1.0, None, "0.1", True])
@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(SafetyLimits) if "box_" not in field.name])
def test_every_number_is_finite_and_positive(name, value):
    with pytest.raises(ParameterError, match=f"{name}: got"):
        limits(**{name: value})


@pytest.mark.parametrize(
    "value", [(0, 0, np.nan), (0, 0, np.inf), (0, 0), (0, 0, 0, 0), None, "abc", 1.0, (0, 0, True)]
)
@pytest.mark.parametrize("name", ["box_low", "box_high"])
def test_every_corner_is_three_finite_numbers(name, value):
    with pytest.raises(ParameterError, match=f"{name}: got"):
        limits(**{name: value})


def test_the_box_is_not_empty_and_has_a_tolerance():
    with pytest.raises(ParameterError, match="low below high"):
        limits(box_low=(0.3, -0.2, 0.01))
    with pytest.raises(ParameterError, match="box_tolerance: got inf"):
        limits(box_tolerance=np.inf)


def test_none_of_the_limits_may_be_left_out():
    with pytest.raises(TypeError):
        SafetyLimits()
    document = limits().to_document()
    for name in document:
        with pytest.raises(ParameterError, match="limits: got"):
            SafetyLimits.from_document({key: value for key, value in document.items() if key != name})
    for wrong in (document | {"speed": 1.0}, None, [1.0]):
        with pytest.raises(ParameterError, match="allowed: the keys box_low"):
            SafetyLimits.from_document(wrong)
    with pytest.raises(ParameterError, match="max_speed: got inf"):
        SafetyLimits.from_document(yaml.safe_load(yaml.safe_dump(document | {"max_speed": float("inf")})))


def spec_of(**changes):
    camera = CameraSpec(32, 32, 40.0, 40.0, 16.0, 16.0, (0.0, -0.45, 0.55), (1.0, 0.0, 0.0, 0.0))
    values = {
        "observes": "rgb",
        "frames": 1,
        "camera": camera,
        "horizon": 0.1,
        "max_translation": 0.02,
        "pusher_low": (-0.35, -0.3),
        "pusher_high": (0.35, 0.4),
        "pusher_height": 0.025,
        "task": PushTask(),
        "max_steps": 100,
    }
    return PolicySpec(**(values | changes))


def test_by_default_a_policy_may_do_what_it_did_in_training():
    made = default_limits(spec_of())
    assert made.box_low == pytest.approx((-0.35, -0.3, 0.015))
    assert made.box_high == pytest.approx((0.35, 0.4, 0.035))
    # 20 mm in 0.1 s, and from there to the opposite in another 0.1 s.
    assert made.max_speed == pytest.approx(0.2)
    assert made.max_acceleration == pytest.approx(4.0)
    assert made.max_image_age == 0.2
    # A robot does not time out between two actions, however far apart they are.
    assert default_limits(spec_of(horizon=1.0)).max_command_age > 1.0


@pytest.mark.parametrize(
    ("motion", "most", "words"),
    [
        ({"acceleration": 3.0}, 3.0, "changes its velocity by at most 3 m/s^2"),
        ({"acceleration": 50.0}, 4.0, "changes its velocity by at most 50 m/s^2"),
        ({"lag": (0.02, 0.04)}, 4.0, "a time constant of 0.02 to 0.04 s"),
        ({}, 4.0, "takes a new velocity at once"),
    ],
)
def test_the_pusher_may_change_its_velocity_as_fast_as_in_training(motion, most, words):
    spec = spec_of(**motion)
    assert PolicySpec.from_document(yaml.safe_load(yaml.safe_dump(spec.to_document()))) == spec
    made = default_limits(spec)
    assert made.max_acceleration == pytest.approx(most)
    assert words in make_contract(spec, made, (10, 20))["notes"]["robot"]


def test_limits_need_neither_torch_nor_drake():
    code = "import sys, pinwm_drake.learning.safety; print([n for n in ('torch', 'pydrake') if n in sys.modules])"
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_robot_is_short_of_what_it_has_less_of():
    wanted = default_limits(spec_of(horizon=0.1, max_translation=0.1))
    slow = dataclasses.replace(wanted, max_acceleration=4.0, max_image_age=0.01)
    assert wanted.shortfall(slow) == "max_acceleration: 4 of 20 m/s^2"
    assert slow.shortfall(wanted) == wanted.shortfall(wanted) == ""
