# SPDX-License-Identifier: MIT
import os
import signal

import numpy as np
import pytest
import torch

from pinwm_drake.errors import ModelError, ParameterError, SolverError, StateError
from pinwm_drake.geometry.shapes import sphere
from pinwm_drake.physics.model import Body, Joint, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from tests.physics.scenes import ball, cube, nominal, push_model, push_start, straight_push, t_block

NAN = float("nan")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"bodies": []}, "no bodies"),
        ({"bodies": [cube(), cube()]}, "'cube' is taken"),
        ({"bodies": [cube("pusher")]}, "'pusher' is taken"),
        ({"bodies": [cube()], "time_step": 0.0}, "time_step is 0.0"),
        ({"bodies": [cube()], "time_step": NAN}, "time_step is nan"),
        ({"bodies": [cube()], "gravity": (0.0, NAN, 0.0)}, "gravity is"),
        ({"bodies": [cube()], "max_contacts": 0}, "max_contacts is 0"),
        ({"bodies": [Body("b", [sphere(0.1)], -1.0, np.eye(3))]}, "mass of 'b' is -1.0 kg"),
        ({"bodies": [Body("b", [sphere(0.1)], 1.0, np.diag([1.0, 1.0, 3.0]))]}, "principal moments"),
        ({"bodies": [Body("b", [sphere(0.1)], 1.0, np.triu(np.ones((3, 3))))]}, "not symmetric"),
        ({"bodies": [cube()], "time_step": 10.0}, "time_step is 10.0; allowed: positive, at most 0.1"),
        ({"bodies": [cube()], "floor_height": NAN}, "floor_height is nan"),
        ({"bodies": [cube()], "gravity": "down"}, "gravity is down"),
        ({"bodies": [cube()], "pusher": []}, "pieces of the pusher: got none"),
        ({"bodies": [Body("b", [], 1.0, np.eye(3))]}, "pieces of 'b': got none"),
        ({"bodies": [Body("b", [sphere(1e-9)], 1.0, np.eye(3))]}, "number 0 is 2e-09 m large"),
        ({"bodies": [Body("b", [sphere(0.1)], None, np.eye(3))]}, "mass of 'b' is None"),
        ({"bodies": [Body("b", [sphere(0.1)], 1e300, np.eye(3))]}, "mass of 'b' is 1e+300".replace("+", r"\+")),
        ({"bodies": [Body("b", [sphere(0.1)], 1.0, 1e-30 * np.eye(3))]}, "principal moment of 1e-30"),
        ({"bodies": [cube()], "joints": [Joint("fixed", "cube", p_A=(0.0, NAN, 0.0))]}, "p_A of a joint of 'cube'"),
        ({"bodies": [cube()], "joints": [Joint("ball", "cube")]}, "joint kind 'ball'"),
        ({"bodies": [cube()], "joints": [Joint("fixed", "cube", "other")]}, "'other'"),
        ({"bodies": [cube()], "joints": [Joint("hinge", "cube", axis_A=(0, 0, 0))]}, "axis"),
    ],
)
def test_a_contradictory_model_is_refused_with_its_value(arguments, said):
    with pytest.raises(ModelError, match=said.replace("(", r"\(")):
        Model(**arguments)


def test_pairs_are_named_and_jointed_bodies_do_not_collide():
    joint = Joint("fixed", "a", "b", p_A=(0.05, 0, 0), p_B=(-0.05, 0, 0))
    model = Model(bodies=[cube("a"), cube("b"), ball()], pusher=[sphere(0.01)], joints=[joint])
    assert model.pair_names == [
        "a-floor",
        "b-floor",
        "ball-floor",
        "a-pusher",
        "b-pusher",
        "ball-pusher",
        "a-ball",
        "b-ball",
    ]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"friction_floor": -0.1}, "friction of 't_block-floor' in world 0 is -0.1"),
        ({"restitution_pusher": 1.5}, "restitution of 't_block-pusher' in world 0 is 1.5"),
    ],
)
def test_parameters_out_of_range_are_named(options, said):
    with pytest.raises(ParameterError, match=said):
        Parameters.nominal(push_model(), **options)


def test_states_that_no_scene_has_are_refused():
    model = push_model()
    for name, value, said in (
        ("p_WB", (0.0, 0.0, -1.0), r"p_WB\[0, 0\] is -1.0 m high; allowed: not all of it below the floor"),
        ("p_WB", (0.0, 2e3, 0.0), r"p_WB\[0, 0, 1\] is 2000; allowed: at most 1000"),
        ("V_WB", (0.0, 0.0, 0.0, 1e6, 0.0, 0.0), r"V_WB\[0, 0, 3\] is 1e\+06; allowed: at most 1000"),
    ):
        with pytest.raises(StateError, match=said):
            State.at_rest(model, **{name: value}).check(model)
    with pytest.raises(StateError, match=r"p_WB is \(3, 1, 3\); allowed: what broadcasts to \(2, 1, 3\)"):
        State.at_rest(model, 2, p_WB=torch.zeros(3, 1, 3))
    with pytest.raises(StateError, match=r"W at least 1"):
        State.at_rest(model, 0).check(model)


@pytest.mark.parametrize("V", [None, torch.tensor(0.0), [[0.0] * 6], torch.zeros(4, 6)], ids=str)
def test_velocities_of_another_shape_are_refused(V):
    model = push_model()
    with pytest.raises(StateError, match=r"V_WP is .*; allowed: a tensor of shape \(1, 1, 6\)"):
        Stepper(model).rollout(nominal(model), push_start(model), V)


def test_a_joint_that_starts_apart_is_refused():
    model = Model(bodies=[cube()], joints=[Joint("hinge", "cube", p_B=(0.0, 0.0, 0.5))])
    state = State.at_rest(model, p_WB=(0.0, 0.0, 0.03))
    with pytest.raises(StateError, match=r"joint 0 \(hinge\) of 'cube' in world 0 is 0.47 m or rad apart"):
        Stepper(model).step(nominal(model), state)


def test_states_are_checked_with_their_entry():
    model = push_model()
    state, theta = push_start(model), nominal(model)
    stepper = Stepper(model)
    bad = {
        "p_WB": (torch.full((1, 1, 3), NAN, dtype=torch.float64), r"p_WB\[0, 0, 0\] is nan"),
        "V_WB": (torch.zeros(1, 1, 6), "torch.float32"),
        "q_WB": (torch.full((1, 1, 4), 1.0, dtype=torch.float64), "norm off by 1"),
        "p_WP": (torch.zeros(1, 2, dtype=torch.float64), r"\(1, 2\)"),
    }
    for name, (value, said) in bad.items():
        fields = {n: getattr(state, n) for n in state.__dataclass_fields__} | {name: value}
        with pytest.raises(StateError, match=said):
            stepper.step(theta, State(**fields))
    with pytest.raises(StateError, match="record_every is 3"):
        stepper.rollout(theta, state, straight_push(10), record_every=3)
    with pytest.raises(StateError, match="V_WP is"):
        stepper.step(theta, state, torch.zeros(1, 3, dtype=torch.float64))
    with pytest.raises(StateError, match="parameters of 2 worlds"):
        stepper.step(theta.expand(2), state)
    with pytest.raises(ModelError, match="'jax'"):
        Stepper(model, backend="jax")
    with pytest.raises(ModelError, match="num_threads is 0"):
        Stepper(model, num_threads=0)


def test_too_many_contacts_is_an_error_that_names_the_limit():
    model = Model(bodies=[t_block()], max_contacts=7)
    state = State.at_rest(model, p_WB=(0.0, 0.0, 0.025))
    for backend in ("numba", "torch"):
        with pytest.raises(SolverError, match="more than 7 contacts"):
            Stepper(model, backend).step(nominal(model), state)
    enough = Model(bodies=[t_block()], max_contacts=8)
    for backend in ("numba", "torch"):
        Stepper(enough, backend).step(nominal(enough), state)


def test_without_a_pusher_its_pose_stays_as_given():
    model = Model(bodies=[t_block()])
    state = State.at_rest(model, 2, p_WB=(0.0, 0.0, 0.025), q_WP=(0.0, 1.0, 0.0, 0.0), p_WP=(1.0, 2.0, 3.0))
    theta = nominal(model).expand(2)
    trajectory = Stepper(model).rollout(theta, state, torch.zeros(6, 2, 6, dtype=torch.float64), record_every=2)
    for frame in range(trajectory.num_frames):
        assert torch.equal(trajectory.frame(frame).q_WP, state.q_WP)
        assert torch.equal(trajectory.frame(frame).p_WP, state.p_WP)
    Stepper(model).step(theta, trajectory.frame(-1))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_starts_threads_of_its_own():
    model = Model(bodies=[cube()])
    state = State.at_rest(model, 4, p_WB=(0.0, 0.0, 0.1))
    theta = nominal(model).expand(4)
    expected = Stepper(model, num_threads=2).step(theta, state).p_WB
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        os._exit(0 if torch.equal(Stepper(model, num_threads=2).step(theta, state).p_WB, expected) else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_a_pendulum_keeps_its_joint_and_its_period():
    # A ball on a hinge 0.2 m above it swings with T = 2 pi sqrt((m l^2 + I) / (m g l)).
    length, radius, mass, g = 0.2, 0.02, 0.3, 9.81
    joint = Joint(
        "hinge", "ball", None, p_A=(0.0, 0.0, length), p_B=(0.0, 0.0, 1.0), axis_A=(0, 1, 0), axis_B=(0, 1, 0)
    )
    model = Model(bodies=[ball(radius=radius, mass=mass)], floor_height=None, joints=[joint], time_step=1e-3)
    amplitude = 0.05
    state = State.at_rest(
        model,
        q_WB=(np.cos(amplitude / 2), 0.0, np.sin(amplitude / 2), 0.0),
        p_WB=(-length * np.sin(amplitude), 0.0, 1.0 - length * np.cos(amplitude)),
    )
    frames = Stepper(model).rollout(nominal(model), state, torch.zeros(2000, 1, 6, dtype=torch.float64))
    x = frames.p_WB[:, 0, 0, 0].numpy()
    crossings = np.flatnonzero(np.diff(np.sign(x))) * model.time_step
    inertia = mass * length**2 + 0.4 * mass * radius**2
    period = 2.0 * np.pi * np.sqrt(inertia / (mass * g * length)) * (1.0 + amplitude**2 / 16.0)
    assert 2.0 * np.diff(crossings).mean() == pytest.approx(period, rel=2e-3)
    # The anchor, 0.2 m along the ball's own z axis, stays where it is.
    from pinwm_drake.spatial.rotations import rotate

    anchor = frames.p_WB + rotate(frames.q_WB, torch.tensor([0.0, 0.0, length]).double().expand_as(frames.p_WB))
    assert float((anchor - torch.tensor([0.0, 0.0, 1.0]).double()).abs().max()) < 1e-5


def test_a_world_that_fails_can_be_held_and_the_others_are_as_without_it():
    model = Model(bodies=[t_block()], max_contacts=7)
    p = torch.tensor([[[0.0, 0.0, 0.025]], [[0.0, 0.0, 0.5]]], dtype=torch.float64)
    state = State.at_rest(model, 2, p_WB=p)
    V = torch.zeros(20, 2, 6, dtype=torch.float64)
    stepper = Stepper(model)
    with pytest.raises(SolverError, match="world 0") as failure:
        stepper.rollout(nominal(model, num_worlds=2), state, V)
    assert failure.value.worlds == (0,)
    moved = p.clone().requires_grad_()
    begun = State(state.q_WB, moved, state.V_WB, state.q_WP, state.p_WP)
    held = stepper.rollout(nominal(model, num_worlds=2), begun, V, record_every=10, on_failure="hold")
    assert held.failed.tolist() == [True, False]
    assert torch.equal(held.p_WB[:, 0], p[0].expand(3, 1, 3))
    alone = stepper.rollout(nominal(model), State.at_rest(model, p_WB=p[1]), V[:, 1:], record_every=10)
    assert torch.equal(held.p_WB[:, 1], alone.p_WB[:, 0])
    held.p_WB[-1].sum().backward()
    assert torch.equal(moved.grad, torch.stack([torch.zeros(1, 3), torch.ones(1, 3)]).double())
    with pytest.raises(StateError, match="on_failure is 'wait'"):
        stepper.rollout(nominal(model, num_worlds=2), state, V, on_failure="wait")


def test_unconstrained_parameters_come_back():
    model = push_model()
    theta = nominal(model, friction_floor=0.03, restitution_floor=0.4, num_worlds=3)
    again = Parameters.from_unconstrained(theta.unconstrained())
    for name in theta.__dataclass_fields__:
        # Restitution 0 is 1e-12 away from where its logit ends.
        torch.testing.assert_close(getattr(again, name), getattr(theta, name), rtol=1e-12, atol=2e-12)


def test_every_unconstrained_vector_is_a_physical_body():
    model = push_model()
    generator = torch.Generator().manual_seed(0)
    values = nominal(model, num_worlds=50).unconstrained()
    moved = {n: v + 2.0 * torch.randn(v.shape, dtype=v.dtype, generator=generator) for n, v in values.items()}
    Parameters.from_unconstrained(moved).check(model)
