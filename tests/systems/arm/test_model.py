# SPDX-License-Identifier: MIT
"""The arm's model: its lengths and limits, and the angles that bring its tool somewhere."""

import numpy as np
import pytest
from pydrake.multibody.tree import JacobianWrtVariable

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.arm.model import REACH_HIGH, REACH_LOW, ArmModel

HEIGHT = 0.025


@pytest.fixture(scope="module")
def model() -> ArmModel:
    return ArmModel(0.0, HEIGHT)


def origin(model: ArmModel, link: str, q: np.ndarray) -> np.ndarray:
    context = model.plant.CreateDefaultContext()
    model.plant.SetPositions(context, q)
    return model.plant.GetFrameByName(link).CalcPoseInWorld(context).translation()


def test_lengths_and_limits_of_the_data_sheet(model):
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


@pytest.mark.parametrize("x", [REACH_LOW[0], 0.0, REACH_HIGH[0]])
@pytest.mark.parametrize("y", [REACH_LOW[1], 0.0, REACH_HIGH[1]])
def test_the_tool_reaches_its_box_with_the_rod_down(model, x, y):
    q = model.positions([x, y, HEIGHT])
    context = model.plant.CreateDefaultContext()
    model.plant.SetPositions(context, q)
    X_WP = model.tool.CalcPoseInWorld(context)
    assert np.abs(X_WP.translation() - [x, y, HEIGHT]).max() < 1e-6
    # The solver keeps to the cosine of the angle, with its tolerance of 1e-8 or so.
    assert np.abs(X_WP.rotation().matrix() - np.eye(3)).max() < 1e-4
    assert (np.abs(q) < model.plant.GetPositionUpperLimits() - 0.02).all()
    # Nowhere near a posture in which it could not move on: 0.35 m stand for 1 rad.
    jacobian = model.plant.CalcJacobianSpatialVelocity(
        context, JacobianWrtVariable.kV, model.tool, np.zeros(3), *[model.plant.world_frame()] * 2
    )
    scaled = np.diag([0.35] * 3 + [1.0] * 3) @ jacobian
    assert np.linalg.svd(scaled)[1].min() > 0.04


@pytest.mark.parametrize("p_WP", [[0.3, 0.0, HEIGHT], [0.0, 0.0, 2.0]])
def test_a_place_out_of_reach_is_refused(model, p_WP):
    with pytest.raises(ParameterError, match="out of the arm's reach"):
        model.positions(p_WP)
