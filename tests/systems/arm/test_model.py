# SPDX-License-Identifier: MIT
"""The arms' models: their lengths and limits, and the angles that bring a tool somewhere."""

import numpy as np
import pytest
from pydrake.multibody.tree import JacobianWrtVariable

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.arm.model import ARMS, ArmModel

HEIGHT = 0.025


# Franka's table: a [m], d [m], α [rad] of each joint and of the flange, in Craig's convention.
QUARTER = np.pi / 2
PANDA = [
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -QUARTER),
    (0.0, 0.316, QUARTER),
    (0.0825, 0.0, QUARTER),
    (-0.0825, 0.384, -QUARTER),
    (0.0, 0.0, QUARTER),
    (0.088, 0.0, QUARTER),
    (0.0, 0.107, 0.0),
]


@pytest.fixture(scope="module")
def models() -> dict[str, ArmModel]:
    return {name: ArmModel(0.0, HEIGHT, name) for name in ARMS}


@pytest.fixture(scope="module")
def panda(models) -> ArmModel:
    return models["panda"]


def origin(model: ArmModel, link: str, q: np.ndarray) -> np.ndarray:
    context = model.plant.CreateDefaultContext()
    model.plant.SetPositions(context, q)
    return model.plant.GetFrameByName(link).CalcPoseInWorld(context).translation()


def test_lengths_and_limits_of_the_data_sheet(models):
    model = models["iiwa"]
    straight = np.zeros(7)
    heights = [origin(model, link, straight)[2] for link in ("base", "link_2", "link_4", "link_6", "rod", "tip")]
    assert np.allclose(np.diff(heights), [0.36, 0.42, 0.4, 0.126, 0.35], atol=1e-12)
    upper = np.degrees(model.plant.GetPositionUpperLimits())
    assert np.allclose(upper, [170, 120, 170, 120, 170, 120, 175], atol=1e-3)
    assert np.allclose(model.plant.GetPositionLowerLimits(), -model.plant.GetPositionUpperLimits())
    assert np.allclose(np.degrees(model.plant.GetVelocityUpperLimits()), [85, 85, 100, 75, 130, 135, 135], atol=1e-3)
    assert np.allclose(model.plant.GetEffortUpperLimits(), [320, 320, 176, 176, 110, 40, 40])
    # 29.9 kg by the data sheet.
    assert abs(model.plant.CalcTotalMass(model.plant.CreateDefaultContext()) - 30) < 1


def flange_of_the_table(q: np.ndarray) -> np.ndarray:
    """(4, 4) pose of the Panda's flange in its base, by the table."""
    X = np.eye(4)
    for (a, d, twist), angle in zip(PANDA, [*q, 0.0], strict=True):
        c, s, ct, st = np.cos(angle), np.sin(angle), np.cos(twist), np.sin(twist)
        X = X @ [[c, -s, 0, a], [s * ct, c * ct, -st, -d * st], [s * st, c * st, ct, d * ct], [0, 0, 0, 1]]
    return X


def test_the_panda_is_that_of_the_table(panda):
    plant = panda.plant
    context, low, high = plant.CreateDefaultContext(), plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    for q in np.random.default_rng(0).uniform(low, high, (20, 7)):
        plant.SetPositions(context, q)
        base, rod, tip = (plant.GetFrameByName(name) for name in ("base", "rod", "tip"))
        X_BR, X_F = rod.CalcPose(context, base).GetAsMatrix4(), flange_of_the_table(q)
        np.testing.assert_allclose(X_BR[:3, 3], X_F[:3, 3], atol=1e-12)
        # The rod goes on along the flange's axis.
        np.testing.assert_allclose(-X_BR[:3, 2], X_F[:3, 2], atol=1e-12)
        X_BT = tip.CalcPose(context, base)
        np.testing.assert_allclose(X_BT.translation(), X_F[:3, 3] + 0.45 * X_F[:3, 2], atol=1e-12)


def test_limits_of_the_panda(panda):
    plant = panda.plant
    low, high = [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973], [2.8973, 1.7628, 2.8973, -0.0698]
    np.testing.assert_array_equal(plant.GetPositionLowerLimits(), low)
    np.testing.assert_array_equal(plant.GetPositionUpperLimits(), [*high, 2.8973, 3.7525, 2.8973])
    np.testing.assert_array_equal(plant.GetVelocityUpperLimits(), [2.175] * 4 + [2.61] * 3)
    np.testing.assert_array_equal(plant.GetAccelerationUpperLimits(), [15, 7.5, 10, 12.5, 15, 20, 20])
    np.testing.assert_array_equal(plant.GetEffortUpperLimits(), [87] * 4 + [12] * 3)
    # 18 kg by the data sheet, and the rod.
    assert abs(plant.CalcTotalMass(plant.CreateDefaultContext()) - 18.1) < 0.1


@pytest.mark.parametrize("x", [-1, 0, 1])
@pytest.mark.parametrize("y", [-1, 0, 1])
@pytest.mark.parametrize(("arm", "height"), [("iiwa", HEIGHT), ("panda", 0.014), ("panda", HEIGHT), ("panda", 0.2)])
def test_the_tool_reaches_its_box_with_the_rod_down(models, x, y, arm, height):
    model = models[arm]
    low, high = np.array(model.kind.reach_low), np.array(model.kind.reach_high)
    x, y = 0.5 * (low + high) + 0.5 * (high - low) * [x, y]
    q = model.positions([x, y, height])
    context = model.plant.CreateDefaultContext()
    model.plant.SetPositions(context, q)
    X_WP = model.tool.CalcPoseInWorld(context)
    assert np.abs(X_WP.translation() - [x, y, height]).max() < 1e-6
    # The solver keeps to the cosine of the angle, with its tolerance of 1e-8 or so.
    assert np.abs(X_WP.rotation().matrix() - np.eye(3)).max() < (1e-4 if arm == "iiwa" else 3e-4)
    assert (q > model.plant.GetPositionLowerLimits() + 0.02).all()
    assert (q < model.plant.GetPositionUpperLimits() - 0.02).all()
    # Nowhere near a posture in which it could not move on: 0.35 m stand for 1 rad.
    jacobian = model.plant.CalcJacobianSpatialVelocity(
        context, JacobianWrtVariable.kV, model.tool, np.zeros(3), *[model.plant.world_frame()] * 2
    )
    scaled = np.diag([0.35] * 3 + [1.0] * 3) @ jacobian
    assert np.linalg.svd(scaled)[1].min() > (0.04 if height < 0.1 else 0.025)


@pytest.mark.parametrize("p_WP", [[0.3, 0.0, HEIGHT], [0.0, 0.0, 2.0]])
@pytest.mark.parametrize("arm", ARMS)
def test_a_place_out_of_reach_is_refused(models, p_WP, arm):
    with pytest.raises(ParameterError, match="out of the arm's reach"):
        models[arm].positions(p_WP)
