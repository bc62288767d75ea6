# SPDX-License-Identifier: MIT
import math

import pytest
import torch

from pinwm_drake.geometry.shapes import cylinder, sphere
from pinwm_drake.physics.model import Body, Joint, Model
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from tests.physics.gradients import flatten, gradients, make_cotangents
from tests.physics.scenes import (
    ball,
    box_inertia,
    cube,
    nominal,
    push_model,
    push_start,
    random_quaternion,
    straight_push,
    t_block,
)

# The kernels and the dense torch reference find the same active set and then solve a linear system with condition
# number up to about 1e8: rounding leaves 1e-8 relative. The kernels' last resort finds bounds of friction to 1e-9 of a
# step's impulse, which is 1e-7 of the velocities of a light body beside heavy ones.
FORWARD, BACKWARD = 1e-7, 1e-6


def compare(model, parameters, state, V_WP, record_every=1, backward=BACKWARD):
    inputs = flatten(parameters, state, V_WP)
    frames = V_WP.shape[0] // record_every + 1
    cotangents = make_cotangents(inputs, frames, torch.Generator().manual_seed(3))
    fast, slow = Stepper(model), Stepper(model, backend="torch")
    (c, ours), (b, theirs) = (gradients(one, inputs, cotangents, record_every) for one in (fast, slow))
    with torch.no_grad():
        a = fast.rollout(parameters, state, V_WP, record_every=record_every)
    for name in State.__dataclass_fields__:
        torch.testing.assert_close(getattr(a, name), getattr(b, name), rtol=FORWARD, atol=FORWARD)
        torch.testing.assert_close(getattr(c, name), getattr(b, name), rtol=FORWARD, atol=FORWARD)
    for name in inputs:
        scale = float(theirs[name].abs().max())
        torch.testing.assert_close(ours[name], theirs[name], rtol=0.0, atol=backward * scale + 1e-10, msg=name)


@pytest.mark.parametrize(
    ("pusher", "steps"),
    [("sphere", 20), *(pytest.param(kind, 40, marks=pytest.mark.nightly) for kind in ("sphere", "capsule"))],
)
def test_a_push_agrees_forward_and_backward(pusher, steps):
    model = push_model(pusher)
    parameters = nominal(model, friction_floor=0.03, friction_pusher=0.2)
    compare(model, parameters, push_start(model), straight_push(steps), record_every=4)


@pytest.mark.parametrize("steps", [18, pytest.param(30, marks=pytest.mark.nightly)])
def test_a_bouncing_push_agrees(steps):
    model = push_model()
    parameters = nominal(model, friction_floor=0.2, friction_pusher=0.3, restitution_pusher=0.4)
    compare(model, parameters, push_start(model), straight_push(steps), record_every=3)


@pytest.mark.parametrize(
    ("seed", "steps"), [(0, 9), *(pytest.param(seed, 12, marks=pytest.mark.nightly) for seed in (0, 1, 2))]
)
def test_tumbling_worlds_agree(seed, steps):
    # Random poses and spins near the floor, different parameters in each world: impacts on corners, edges, faces.
    # Spins are slow: the reference does not halve steps in which a body turns into the floor.
    generator = torch.Generator().manual_seed(seed)
    model = push_model()
    W = 6
    parameters = nominal(model, friction_floor=0.4, friction_pusher=0.3, num_worlds=W)
    spread = 1.0 + 0.2 * torch.rand(W, 1, dtype=torch.float64, generator=generator)
    parameters = type(parameters)(
        parameters.mass * spread,
        parameters.inertia * spread[..., None, None],
        parameters.friction * spread,
        parameters.restitution + 0.1 * (spread - 1.0),
    )
    state = State.at_rest(
        model,
        W,
        q_WB=random_quaternion(generator, W, 1),
        p_WB=torch.tensor([0.0, 0.0, 0.08]),
        V_WB=torch.randn(W, 1, 6, dtype=torch.float64, generator=generator) * torch.tensor([1.0] * 3 + [0.3] * 3),
        p_WP=(0.0, 0.0, 0.3),
    )
    compare(model, parameters, state, torch.zeros(steps, W, 6, dtype=torch.float64), record_every=3)


@pytest.mark.parametrize("steps", [2, pytest.param(12, marks=pytest.mark.nightly)])
def test_bodies_that_touch_each_other_agree(steps):
    model = Model(bodies=[cube("a"), cube("b", edge=0.04, mass=0.2), ball()], pusher=[sphere(0.01)])
    parameters = nominal(model, friction_floor=0.3, friction_bodies=0.4, restitution_bodies=0.2)
    p = torch.tensor([[0.0, 0.0, 0.025], [0.004, 0.003, 0.0701], [0.048, 0.002, 0.02]], dtype=torch.float64)
    V = torch.tensor([[0.0] * 6, [0.1, 0.2, 0.3, 0.0, 0.0, -0.1], [0.0, 0.0, 0.0, -0.6, 0.0, 0.0]], dtype=torch.float64)
    state = State.at_rest(model, p_WB=p, V_WB=V, p_WP=(-0.04, 0.001, 0.02))
    compare(model, parameters, state, straight_push(steps, velocity=(0.3, 0.0, 0.0)), record_every=2)


@pytest.mark.parametrize("kind", ["fixed", "no_rotation", "no_translation", "hinge"])
def test_joints_agree(kind):
    # Two cubes in free fall above the floor, joined to each other, and one of them to the pusher.
    joints = [
        Joint(
            kind,
            "a",
            "b",
            p_A=(0.05, 0.0, 0.0),
            p_B=(-0.05, 0.0, 0.0),
            axis_A=(0, 0.6, 0.8),
            axis_B=(0, 0.6, 0.8),
        ),
        Joint(
            "no_translation",
            "a",
            "pusher",
            p_A=(0.0, 0.0, 0.025),
            p_B=(0.0, 0.0, 0.0),
            axis_B=(0.0, 0.0, 1.0),
        ),
    ]
    model = Model(bodies=[cube("a"), cube("b", mass=0.2)], pusher=[sphere(0.005)], joints=joints)
    generator = torch.Generator().manual_seed(5)
    V = torch.randn(1, 2, 6, dtype=torch.float64, generator=generator)
    p = torch.tensor([[-0.05, 0.0, 0.03], [0.05, 0.0, 0.03]], dtype=torch.float64)
    state = State.at_rest(model, p_WB=p, V_WB=V, p_WP=(-0.05, 0.0, 0.055))
    # The derivative of the position error of an angular row leaves out terms of the size of the drift.
    compare(
        model,
        nominal(model),
        state,
        straight_push(12, velocity=(0.1, 0.0, 0.05)),
        record_every=3,
        backward=1e-4,
    )


def test_a_cylinder_that_rolls_and_a_cylinder_pusher_agree():
    tilt = math.radians(89.0)
    body = Body("can", [cylinder(0.03, 0.08)], 0.3, box_inertia((0.05, 0.05, 0.08), 0.3))
    model = Model(bodies=[body], pusher=[cylinder(0.01, 0.06)])
    state = State.at_rest(
        model,
        q_WB=(math.cos(tilt / 2), math.sin(tilt / 2), 0.0, 0.0),
        p_WB=(0.0, 0.0, 0.0312),
        V_WB=(0.0, 1.0, 0.1, 0.03, 0.0, 0.0),
        p_WP=(-0.041, 0.0, 0.032),
    )
    parameters = nominal(model, friction_floor=0.4, friction_pusher=0.2)
    compare(model, parameters, state, straight_push(20, velocity=(0.2, 0.02, 0.01)), record_every=4)


def test_worlds_do_not_depend_on_each_other_or_on_threads():
    model = push_model()
    one = nominal(model, friction_floor=0.05, friction_pusher=0.1)
    state, V = push_start(model), straight_push(60)
    alone = Stepper(model, num_threads=1).rollout(one, state, V, record_every=20)
    many = Stepper(model).rollout(
        one.expand(5),
        State(*(x.expand(5, *x.shape[1:]) for x in vars(state).values())),
        V.expand(-1, 5, -1),
        record_every=20,
    )
    for name in State.__dataclass_fields__:
        for world in range(5):
            assert torch.equal(getattr(many, name)[:, world], getattr(alone, name)[:, 0])


def test_a_rollout_may_be_cut_anywhere():
    # A step depends on its state alone, not on what a rollout remembers to solve faster.
    model = push_model()
    parameters, state, V = (
        nominal(model, friction_floor=0.05, friction_pusher=0.1),
        push_start(model),
        straight_push(60),
    )
    stepper = Stepper(model)
    whole = stepper.rollout(parameters, state, V, record_every=60).frame(-1)
    half = stepper.rollout(parameters, state, V[:27], record_every=27).frame(-1)
    rest = stepper.rollout(parameters, half, V[27:], record_every=33).frame(-1)
    for name in State.__dataclass_fields__:
        torch.testing.assert_close(getattr(whole, name), getattr(rest, name), rtol=0.0, atol=1e-12)


def test_t_block_has_the_documented_shape():
    body = t_block()
    assert body.mass == 1.0
    assert body.inertia[2, 2] == pytest.approx(0.002191666, rel=1e-5)


def test_a_mug_that_wobbles_on_its_rim_agrees():
    body = Body("can", [cylinder(0.03, 0.08)], 0.3, box_inertia((0.05, 0.05, 0.08), 0.3))
    model, tilt = Model(bodies=[body], pusher=[sphere(0.01)]), 0.1
    state = State.at_rest(
        model,
        q_WB=(math.cos(tilt / 2), 0.6 * math.sin(tilt / 2), 0.8 * math.sin(tilt / 2), 0.0),
        p_WB=(0.0, 0.0, 0.04 * math.cos(tilt) + 0.03 * math.sin(tilt) + 1e-5),
        p_WP=(0.3, 0.0, 0.1),
        V_WB=(0.3, -0.5, 1.0, 0.02, 0.0, 0.0),
    )
    compare(model, nominal(model, friction_floor=0.3), state, straight_push(8))
