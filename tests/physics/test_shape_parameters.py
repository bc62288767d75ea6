# SPDX-License-Identifier: MIT
"""Centre of mass, spread of the pressure and offset of the surfaces, which belong to a world and not to the model."""

import dataclasses
import math

import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.geometry.patch import supporting_points
from pinwm_drake.geometry.pieces import IF_LYING, PROTRUSION, ConvexPiece
from pinwm_drake.geometry.shapes import box, capsule, cylinder, sphere
from pinwm_drake.geometry.stored_pieces import mesh_pieces
from pinwm_drake.models import object_model
from pinwm_drake.physics.model import Body, Joint, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from tests.physics.gradients import central_difference, flatten, gradients, make_cotangents
from tests.physics.scenes import nominal, push_start, straight_push
from tests.physics.test_reference import compare

UPRIGHT = np.eye(3)


def tensor(*values):
    return torch.tensor(values, dtype=torch.float64)


def block(moved=(0.0, 0.0, 0.0), pusher=0.01):
    """T-block on the points of its face, whose pieces are moved in B by `moved` (m)."""
    path = object_model("t_block").mesh_path
    mesh = load_mesh(path)
    properties = mass_properties(mesh, mass=1.0)
    by = np.array(moved) - properties.p_com
    points = supporting_points(mesh, UPRIGHT)
    points[:, :3] += by
    pieces = [ConvexPiece(p.kind, p.vertices + by, p.radius, p.faces) for p in mesh_pieces(path)]
    return Model(bodies=[Body("block", pieces, 1.0, properties.inertia, floor_points=points)], pusher=[sphere(pusher)])


def pushed(model, **changes):
    parameters = dataclasses.replace(nominal(model, friction_floor=0.2, friction_pusher=0.3), **changes)
    state = push_start(model)
    state = dataclasses.replace(state, p_WB=state.p_WB + tensor(0.0, 0.0, PROTRUSION))
    return parameters, state, straight_push(60)


SHAPE = {
    "center": tensor([0.004, -0.006, 0.003]),
    "spread": tensor([0.8, 1.2, 1.1]),
    "offset": tensor(-1e-4, 0.002),
}


@pytest.mark.parametrize("steps", [15, pytest.param(30, marks=pytest.mark.nightly)])
def test_kernels_and_reference_agree_forward_and_backward(steps):
    model = block()
    changes = {name: value[None] for name, value in SHAPE.items()}
    parameters, state, V_WP = pushed(model, **changes)
    # On the floor: which of a face's points lands first decides a derivative.
    state = dataclasses.replace(state, p_WB=state.p_WB + tensor(0.0, 0.0, float(SHAPE["offset"][0])))
    compare(model, parameters, state, V_WP[:steps], record_every=3)


@pytest.mark.parametrize("name", SHAPE)
def test_derivatives_of_a_push_agree_with_central_differences(name):
    stepper = Stepper(block())
    inputs = flatten(*pushed(stepper.model, spread=tensor([[0.8, 1.2, 1.0]])))
    cotangents = make_cotangents(inputs, 7, torch.Generator().manual_seed(1))
    # Along z, and from the floor, a shift lifts the block: a kink.
    ways = {"center": tensor(1.0, -0.5, 0.0), "spread": tensor(1.0, 0.7, 0.0), "offset": tensor(0.0, 1.0)}
    direction = ways[name].expand_as(inputs[name])
    analytic = float((gradients(stepper, inputs, cotangents, 10)[1][name] * direction).sum())
    errors = [
        abs(central_difference(stepper, inputs, cotangents, 10, name, direction, step) / analytic - 1.0)
        for step in (1e-3, 1e-4, 1e-5, 1e-6)
    ]
    assert abs(analytic) > 1e-3
    assert min(errors) < 1e-4, errors


def test_a_moved_centre_of_mass_is_that_of_moved_pieces():
    away = np.array([0.008, -0.005, 0.004])
    parameters, state, V_WP = pushed(block(), center=tensor([away.tolist()]))
    state = dataclasses.replace(state, p_WB=state.p_WB + tensor(0.0, 0.0, 0.004))
    ours = Stepper(block()).rollout(parameters, state, V_WP)
    moved = Stepper(block(-away)).rollout(nominal(block(), friction_floor=0.2, friction_pusher=0.3), state, V_WP)
    # The points of the face spread about another foot, but by factors of one.
    torch.testing.assert_close(ours.p_WB, moved.p_WB, rtol=0.0, atol=1e-12)
    torch.testing.assert_close(ours.q_WB, moved.q_WB, rtol=0.0, atol=1e-11)
    assert float((ours.p_WB[-1] - ours.p_WB[0]).norm()) > 0.02


def test_an_offset_is_a_larger_pusher():
    parameters, state, V_WP = pushed(block(), offset=tensor([0.0, 0.003]))
    larger = Stepper(block(pusher=0.013)).rollout(
        nominal(block(), friction_floor=0.2, friction_pusher=0.3), state, V_WP
    )
    offset = Stepper(block()).rollout(parameters, state, V_WP)
    plain = Stepper(block()).rollout(dataclasses.replace(parameters, offset=None), state, V_WP)
    # The lever of friction differs by half of the offset.
    torch.testing.assert_close(offset.p_WB, larger.p_WB, rtol=0.0, atol=3e-4)
    assert float((plain.p_WB[-1] - larger.p_WB[-1]).norm()) > 2e-3


@pytest.mark.parametrize("spread", [0.5, 1.0, 1.6])
@pytest.mark.parametrize("face", [(0.0, 0.0, 0.0), (0.0, -math.pi / 2, 0.0)])
def test_torque_against_a_spin_grows_with_the_spread(spread, face):
    # Of uniform pressure on a square: mu m g times 0.3826 sides; every arm grows with the spread.
    from pinwm_drake.spatial.rotations import quaternion_exp

    side, mu, w = 0.06, 0.3, 10.0
    points = supporting_points(trimesh.creation.box((side,) * 3), UPRIGHT)
    inertia = 0.5 / 6.0 * side**2
    model = Model(
        bodies=[Body("cube", [box((side,) * 3)], 0.5, inertia * np.eye(3), floor_points=points)], time_step=1 / 960
    )
    state = State.at_rest(
        model,
        q_WB=quaternion_exp(tensor(*face)).expand(1, 1, 4),
        p_WB=(0.0, 0.0, 0.5 * side + PROTRUSION),
        V_WB=tensor(0.0, 0.0, w, 0.0, 0.0, 0.0).expand(1, 1, 6),
    )
    theta = dataclasses.replace(
        Parameters.nominal(model, friction_floor=mu), spread=torch.full((1, 1, 3), spread, dtype=torch.float64)
    )
    rolled = Stepper(model).rollout(theta, state, torch.zeros(24, 1, 6, dtype=torch.float64))
    torque = spread * mu * 0.5 * 9.81 * side * (math.sqrt(2) + math.asinh(1)) / 6
    assert w - float(rolled.V_WB[-1, 0, 0, 2]) == pytest.approx(torque / inertia * 24 / 960, rel=0.02)


def test_values_out_of_range_are_refused():
    model = block()
    plain = nominal(model)
    for name, value in (("center", 2.0), ("spread", 0.0), ("offset", 0.1)):
        wrong = torch.full_like(getattr(plain, name), value)
        with pytest.raises(ParameterError, match=name):
            dataclasses.replace(plain, **{name: wrong}).check(model)
    two = Model(
        bodies=[Body(name, [box((0.1,) * 3)], 1.0, 0.01 * np.eye(3)) for name in "ab"],
        joints=[Joint("fixed", "a", "b")],
    )
    jointed = nominal(two)
    with pytest.raises(ParameterError, match="center"):
        dataclasses.replace(jointed, center=jointed.center + 0.001).check(two)


def lying(make, even=True, spread=1.0, velocity=(0.0, 0.0, 8.0, 0.0, 0.0, 0.0)):
    """Cylinder or capsule of 0.1 m that lies along x, and turns about z."""
    from pinwm_drake.spatial.rotations import quaternion_exp

    body = Body("roll", [make(0.03, 0.1)], 0.5, np.diag([8e-4, 8e-4, 2e-4]), even_lines=even)
    model = Model(bodies=[body], pusher=[sphere(0.01)], time_step=1 / 960)
    state = State.at_rest(
        model,
        p_WP=(1.0, 1.0, 1.0),
        q_WB=quaternion_exp(tensor(0.0, math.pi / 2, 0.0)).expand(1, 1, 4),
        p_WB=(0.0, 0.0, 0.03 + (PROTRUSION if even else 0.0)),
        V_WB=tensor(*velocity).expand(1, 1, 6),
    )
    theta = Parameters.nominal(model, friction_floor=0.2, friction_pusher=0.2)
    return model, dataclasses.replace(theta, spread=torch.full((1, 1, 3), spread, dtype=torch.float64)), state


@pytest.mark.parametrize("make", [cylinder, capsule])
@pytest.mark.parametrize(("even", "spread", "share"), [(True, 1.0, 0.25), (True, 1.4, 0.35), (False, 1.0, 0.5)])
def test_a_lying_round_piece_that_spins_meets_the_torque_of_its_line(make, even, spread, share):
    # Even pressure on a line of length L: mu m g L / 4; at its ends alone: mu m g L / 2.
    model, theta, state = lying(make, even, spread)
    rolled = Stepper(model).rollout(theta, state, torch.zeros(24, 1, 6, dtype=torch.float64))
    torque = share * 0.2 * 0.5 * 9.81 * 0.1
    lost = 8.0 - float(rolled.V_WB[-1, 0, 0, 2])
    # Two points stand for the line: 6 % more, so that they are right as well where it slides. Ends are round or inset.
    assert lost == pytest.approx(torque / 8e-4 * 24 / 960, rel=0.08)


def test_a_lying_cylinder_that_slides_along_itself_and_turns_meets_the_torque_of_its_line():
    # Friction turns with the velocity: torque mu m g w L^2 / (12 v) where the spin is slow.
    v, w = 0.5, 0.4
    model, theta, state = lying(cylinder, velocity=(0.0, 0.0, w, v, 0.0, 0.0))
    rolled = Stepper(model).rollout(theta, state, torch.zeros(24, 1, 6, dtype=torch.float64))
    torque = 0.2 * 0.5 * 9.81 * w * 0.1**2 / (12.0 * v)
    assert w - float(rolled.V_WB[-1, 0, 0, 2]) == pytest.approx(torque / 8e-4 * 24 / 960, rel=0.2)


def test_derivatives_by_the_spread_of_a_lying_cylinder_agree_with_the_reference_and_differences():
    model, theta, state = lying(cylinder, velocity=(0.2, 0.3, 3.0, 0.3, 0.1, 0.0))
    V_WP = torch.zeros(60, 1, 6, dtype=torch.float64)
    compare(model, theta, state, V_WP[:12], record_every=3)
    stepper = Stepper(model)
    inputs = flatten(theta, state, V_WP)
    cotangents = make_cotangents(inputs, 7, torch.Generator().manual_seed(2))
    direction = tensor(0.3, 0.5, 1.0).expand_as(inputs["spread"])
    analytic = float((gradients(stepper, inputs, cotangents, 10)[1]["spread"] * direction).sum())
    errors = [
        abs(central_difference(stepper, inputs, cotangents, 10, "spread", direction, step) / analytic - 1.0)
        for step in (1e-3, 1e-4, 1e-5)
    ]
    assert abs(analytic) > 1e-3
    assert min(errors) < 1e-4, errors


def test_a_short_piece_has_no_points_on_its_axis():
    body = Body("coin", [cylinder(0.04, 0.01)], 0.5, 1e-4 * np.eye(3), even_lines=True)
    assert not (Model(bodies=[body]).arrays.table.floor_owners == IF_LYING).any()
