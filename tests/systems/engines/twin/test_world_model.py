# SPDX-License-Identifier: MIT
import dataclasses

import numpy as np
import pytest
import torch
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from pinwm_drake.errors import ParameterError, SolverError, StateError
from pinwm_drake.physics.diagnose import inspect
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.systems.cameras.surfel_images import WorldImages
from pinwm_drake.systems.engines.twin import physics as world_physics
from pinwm_drake.systems.engines.twin.world_model import WorldModel, rest_state
from pinwm_drake.systems.scenario.schema import Physics, Scenario, Start, Theta, View
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.scenario.start import StartDistribution

H = 1 / 240


def setup_of(num_worlds: int = 1, steps: int = 1, friction: float = 0.1) -> Setup:
    return make_setup(
        Scenario(
            object="t_block",
            theta=Theta(friction_floor=friction, friction_pusher=0.2),
            physics=Physics(steps_per_update=steps),
            camera=View(width=96, height=96),
            start=Start(pusher_angle=[3.0, 3.0], pusher_gap=[0.0, 0.0]),
            num_worlds=num_worlds,
        )
    )


@pytest.fixture(scope="module")
def one() -> WorldModel:
    return WorldModel(setup_of())


def pushed(world: WorldModel, v_WP: tuple[float, float, float] = (0.4, 0.05, 0.0)) -> Context:
    """A context in which every pusher moves towards its object."""
    context = world.CreateDefaultContext()
    world.get_input_port().FixValue(context, np.tile(v_WP, world.num_worlds))
    return context


def state_at(world: WorldModel, context: Context, t: float) -> np.ndarray:
    """(W, 13) of the objects."""
    Simulator(world, context).AdvanceTo(t)
    return world.GetOutputPort("object_state").Eval(context).reshape(-1, 13).copy()


def physics_state(context: Context) -> State:
    """The state of one world as the physics has it; the centre of mass is at O up to rounding."""
    object_state, pusher = (torch.from_numpy(context.get_discrete_state(k).value().copy()) for k in (0, 1))
    parts = [object_state[None, None, part] for part in (np.s_[:4], np.s_[4:7], np.s_[7:])]
    return State(*parts, torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64), pusher[None, :3])


def test_it_takes_the_very_steps_that_identification_differentiates(one):
    context = pushed(one)
    state = physics_state(context)
    first = state.p_WB.clone()
    found = state_at(one, context, 60 * H)[0]
    stepper = Stepper(one.physics.scene.model)
    V_WP = torch.tensor([[[0, 0, 0, 0.4, 0.05, 0.0]]], dtype=torch.float64)
    for _ in range(60):
        state = stepper.rollout(one.GetParameters(context), state, V_WP).frame(-1)
    assert (state.p_WB - first).abs().max() > 1e-3  # the object was moved
    expected = torch.cat([state.q_WB[0, 0], state.p_WB[0, 0], state.V_WB[0, 0]]).numpy()
    assert (found == expected).all()
    assert (one.GetOutputPort("pusher_state").Eval(context)[:3] == state.p_WP[0].numpy()).all()


def test_a_parameter_is_found_by_gradient_from_what_the_diagram_logged(one):
    builder = DiagramBuilder()
    world = builder.AddSystem(WorldModel(setup_of(friction=0.13)))
    source = builder.AddSystem(ConstantVectorSource([0.4, 0.05, 0.0]))
    builder.Connect(source.get_output_port(), world.get_input_port())
    logger = LogVectorOutput(world.GetOutputPort("object_state"), builder, H)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    state = physics_state(world.GetMyContextFromRoot(simulator.get_context()))
    simulator.AdvanceTo(96 * H)
    log = logger.FindLog(simulator.get_context())
    # Drake logs before it updates: entry k is the state after k steps.
    observed = torch.from_numpy(log.data().T[:96:8, 4:7].copy())
    stepper, physics = Stepper(one.physics.scene.model), one.physics
    V_WP = torch.tensor([0, 0, 0, 0.4, 0.05, 0.0], dtype=torch.float64).expand(96, 1, 6)
    nominal = physics.parameters(1)
    log_friction = torch.tensor(0.05, dtype=torch.float64).log().requires_grad_()
    optimiser = torch.optim.LBFGS([log_friction], max_iter=30, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
        optimiser.zero_grad()
        friction = torch.stack([log_friction.exp(), nominal.friction[0, 1]])[None]
        theta = Parameters(nominal.mass, nominal.inertia, friction, nominal.restitution)
        record = stepper.rollout(theta, state, V_WP, record_every=8)
        value = 1e4 * ((record.p_WB[:12, 0, 0] - observed) ** 2).sum()
        value.backward()
        return value

    optimiser.step(loss)
    assert abs(log_friction.exp().item() / 0.13 - 1) < 1e-3  # measured: 5e-5


def test_substeps_in_one_update_are_the_same_steps(one):
    many = WorldModel(setup_of(steps=12))
    fine, coarse = state_at(one, pushed(one), 60 * H), state_at(many, pushed(many), 60 * H)
    # A step's solution does not depend on where its solver starts, but for rounding.
    assert np.abs(fine - coarse).max() < 1e-9


def test_worlds_do_not_mix():
    world, alone = WorldModel(setup_of(num_worlds=3)), WorldModel(setup_of())
    context = world.CreateDefaultContext()
    velocities = np.array([[0.4, 0.05, 0], [0, 0, 0], [0.3, -0.03, 0]])
    world.get_input_port().FixValue(context, velocities.ravel())
    found = state_at(world, context, 60 * H)
    for row, v_WP in zip(found, velocities, strict=True):
        assert (row == state_at(alone, pushed(alone, tuple(v_WP)), 60 * H)[0]).all()


def test_a_clone_and_a_saved_context_go_on_bit_by_bit(one):
    context = pushed(one)
    Simulator(one, context).AdvanceTo(30 * H)
    clone, saved = context.Clone(), [context.get_discrete_state(k).value().copy() for k in (0, 1)]
    end = state_at(one, context, 70 * H)
    assert (state_at(one, clone, 70 * H) == end).all()
    restored = pushed(one)
    restored.SetTime(30 * H)
    for k, values in enumerate(saved):
        restored.SetDiscreteState(k, values)
    assert (state_at(one, restored, 70 * H) == end).all()
    assert (state_at(one, pushed(one), 70 * H) == end).all()


def test_theta_is_a_parameter_of_the_context(one):
    slippery, rough = pushed(one), pushed(one)
    theta = one.GetParameters(rough)
    one.SetParameters(rough, dataclasses.replace(theta, friction=torch.tensor([[1.0, 0.2]], dtype=torch.float64)))
    assert one.GetParameters(slippery).friction[0, 0] == 0.1
    clone = rough.Clone()
    ends = [state_at(one, context, 90 * H) for context in (slippery, rough, clone)]
    assert np.abs(ends[0] - ends[1]).max() > 1e-3
    assert (ends[1] == ends[2]).all()


def test_theta_out_of_range_is_refused(one):
    context = pushed(one)
    wrong = dataclasses.replace(one.GetParameters(context), friction=torch.tensor([[-0.1, 0.2]], dtype=torch.float64))
    with pytest.raises(ParameterError, match="friction"):
        one.SetParameters(context, wrong)
    context.get_mutable_numeric_parameter(0).SetFromVector([-1.0])  # behind its back
    with pytest.raises(Exception, match="mass"):
        state_at(one, context, H)


def test_cousins_have_their_own_colours():
    world = WorldModel(setup_of(num_worlds=2))
    context = pushed(world)
    sh = torch.stack([world._images.surfels.sh, torch.zeros_like(world._images.surfels.sh)])
    world.SetColors(context, sh)
    first, second = world.GetOutputPort("rgb_batch").Eval(context)
    shown = second[..., 3] == 255
    assert (np.abs(second[shown][:, :3].astype(int) - 128) <= 1).all()  # no harmonics: grey
    assert np.ptp(first[shown][:, :3]) > 100
    with pytest.raises(ParameterError, match="sh"):
        world.SetColors(context, sh[:, :3])


def test_a_world_has_a_camera_of_its_own():
    setup = setup_of(num_worlds=2)
    X_WC = setup.X_WC @ RigidTransform(RollPitchYaw(0.02, -0.03, 0.05), [0.01, 0.02, -0.02])
    world, there = WorldModel(setup), WorldModel(dataclasses.replace(setup, X_WC=X_WC))
    context = pushed(world)
    world.SetCamera(context, X_WC, 1)
    usual, moved = world.GetOutputPort("rgb_batch").Eval(context)
    np.testing.assert_array_equal(moved, there.GetOutputPort("rgb_batch").Eval(pushed(there))[1])
    assert (moved != usual).mean() > 0.01
    world.SetCamera(context, X_WC)
    np.testing.assert_array_equal(world.GetOutputPort("rgb_batch").Eval(context)[0], moved)
    with pytest.raises(StateError, match="world"):
        world.SetCamera(context, X_WC, 2)


def test_a_light_from_above_shows_the_upper_side_alone_and_turns_not_with_the_object():
    world = WorldModel(setup_of(2))
    context = pushed(world)
    usual = world.GetOutputPort("rgb_batch").Eval(context)[..., :3].astype(float)
    world.SetLight(context, [0.0, 0.0, 0.0, 1.0], 1)
    plain, lit = world.GetOutputPort("rgb_batch").Eval(context)[..., :3].astype(float)
    np.testing.assert_array_equal(plain, usual[0])
    shown = usual[1].min(2) < 255
    share = lit[shown].sum(1) / np.maximum(usual[1][shown].sum(1), 1.0)
    assert 0.3 < (share > 0.95).mean() < 0.95  # the upper side
    assert (share < 0.1).mean() > 0.03  # the sides
    over = RigidTransform(RollPitchYaw(np.pi, 0.0, 0.0), [0.0, 0.0, 0.1])
    states = [rest_state(over)] * 2
    world.SetState(context, np.array(states), np.full((2, 3), 0.3))
    plain, lit = world.GetOutputPort("rgb_batch").Eval(context)[..., :3].astype(float)
    shown = plain.min(2) < 255
    share = lit[shown].sum(1) / np.maximum(plain[shown].sum(1), 1.0)
    assert 0.3 < (share > 0.95).mean() < 0.95
    world.SetLight(context, [1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(world.GetOutputPort("rgb_batch").Eval(context)[1, ..., :3], plain)
    with pytest.raises(StateError, match="world"):
        world.SetLight(context, np.ones(4), 2)
    with pytest.raises(StateError, match=r"light: got .*nan.*; allowed: 4 finite numbers"):
        world.SetLight(context, [np.nan, 0.0, 0.0, 0.0])
    for light in (0.5, [0.0, 0.0, 1.0]):
        with pytest.raises(StateError, match=r"light: got .*; allowed: 4 finite numbers"):
            world.SetLight(context, light)


def test_images_are_rendered_only_when_asked_for_and_once(one, monkeypatch):
    taken = []
    take = WorldImages.take
    monkeypatch.setattr(WorldImages, "take", lambda self, *given: taken.append(1) or take(self, *given))
    context = pushed(one)
    Simulator(one, context).AdvanceTo(20 * H)
    assert not taken
    rgb = one.GetOutputPort("rgb")
    picture = rgb.Eval(context).data.copy()
    assert (rgb.Eval(context).data == picture).all()
    assert len(taken) == 1
    Simulator(one, context).AdvanceTo(40 * H)
    assert not (rgb.Eval(context).data == picture).all()
    assert len(taken) == 2
    one.get_input_port().FixValue(context, np.zeros(3))
    rgb.Eval(context)
    assert len(taken) == 2  # what the pusher is told does not change the picture


def test_the_pusher_hides_the_object_only_from_the_front(one):
    context = one.CreateDefaultContext()
    setup = setup_of()
    X_WO = StartDistribution(setup).middle().X_WO
    towards = setup.X_WC.translation() - X_WO.translation()
    pictures = []
    for p_WP in (np.array([0, 0, 50.0]), X_WO.translation() + 0.2 * towards, X_WO.translation() - 0.2 * towards):
        one.SetState(context, rest_state(X_WO), p_WP)
        pictures.append(one.GetOutputPort("rgb").Eval(context).data.copy())
    free, before, behind = ((picture[..., 3] == 255).sum() for picture in pictures)
    assert free - before >= 9  # a sphere of 10 mm, 0.56 m away, is 2.3 px wide on each side
    assert behind == free
    assert (pictures[0][pictures[0][..., 3] == 0][:, :3] == 255).all()


def test_only_contact_forces_feed_through(one):
    through = {
        name
        for name in ("object_state", "pusher_state", "plant_positions", "rgb", "rgb_batch", "contact_forces")
        if one.HasDirectFeedthrough(one.GetOutputPort(name).get_index())
    }
    assert through == {"contact_forces"}


def test_contact_forces_bear_the_weight(one):
    context = one.CreateDefaultContext()
    one.get_input_port().FixValue(context, np.zeros(3))
    Simulator(one, context).AdvanceTo(0.1)
    forces = one.GetOutputPort("contact_forces").Eval(context)
    assert set(forces.pairs) == {"object-floor"}
    assert np.abs(forces.f_W.sum(axis=0) - [0, 0, 9.81]).max() < 1e-6
    assert np.abs(forces.p_WC[:, 2]).max() < 1e-4


def test_the_impulse_of_a_pusher_is_the_momentum_that_it_gives_on_a_floor_without_friction():
    world = WorldModel(setup_of(2, steps=30, friction=0.0))
    context = pushed(world)
    state_at(world, context, 0.0)  # at rest
    moved = state_at(world, context, 30 * H)
    mass = world.GetParameters(context).mass[:, 0].numpy()
    momentum = mass * np.linalg.norm(moved[:, 10:13], axis=1)
    assert momentum.min() > 0.1
    np.testing.assert_allclose(world.GetPusherImpulse(context), momentum, rtol=1e-4)  # it rubs a little upwards too
    world.get_input_port().FixValue(context, np.tile([-0.4, 0.0, 0.0], 2))  # away from it
    state_at(world, context, 60 * H)
    np.testing.assert_allclose(world.GetPusherImpulse(context), momentum, rtol=1e-4)  # it rubs a little upwards too


def test_states_at_another_point_than_the_centre_of_mass(one, monkeypatch):
    physics = one.physics
    p_OB = np.array([0.01, -0.02, 0.005])
    monkeypatch.setattr(physics, "_p_OB", p_OB)
    X_WO = RigidTransform(RollPitchYaw(0.3, -0.2, 0.7), [0.1, 0.2, 0.3])
    V_WO = np.array([0.5, -1.0, 2.0, 0.1, 0.2, -0.3])
    state = rest_state(X_WO, V_WO)[None]
    _, p_WB, V_WB, _, _ = physics._at_B(np.zeros((1, 1, 3)), state, np.zeros((1, 3)))
    assert np.allclose(p_WB[0, 0], X_WO @ p_OB, atol=1e-15)
    assert np.allclose(V_WB[0, 0, 3:], V_WO[3:] + np.cross(V_WO[:3], X_WO.rotation() @ p_OB), atol=1e-15)
    # In free fall the centre of mass flies straight, and O around it.
    theta = tuple(values.numpy().copy() for values in physics.parameters(1).tensors())
    after, _, _ = physics.advance(theta, state, np.array([[0.0, 0, 10]]), np.zeros((1, 3)))
    R_WO = RigidTransform(Quaternion(after[0, :4]), after[0, 4:7]).rotation()
    moved = after[0, 4:7] + R_WO @ p_OB - X_WO @ p_OB
    assert np.allclose(moved, H * (V_WB[0, 0, 3:] + [0, 0, -0.5 * 9.81 * H]), atol=1e-15)


def test_a_world_without_a_solution_takes_shorter_steps(one, monkeypatch):
    physics, context = one.physics, pushed(one)
    theta = tuple(np.repeat(values, 3, axis=0) for values in one._checked.Eval(context)[1])
    state = np.tile(context.get_discrete_state(0).value(), (3, 1))
    state[:, 10] = 0.3
    given = (theta, state, np.tile([0.0, 0, 10], (3, 1)), np.array([[0.1, 0, 0], [0.15, 0, 0], [0.2, 0, 0]]))
    expected, _, _ = physics.advance(*given)
    roll = Stepper.roll

    def refuse(self, theta, state, V_WP, *others, **named):
        bad = np.flatnonzero(V_WP[0, :, 3] == 0.15)
        if len(bad) and self.model.time_step > 0.9 * H:
            raise SolverError("world", worlds=tuple(bad))
        return roll(self, theta, state, V_WP, *others, **named)

    monkeypatch.setattr(Stepper, "roll", refuse)
    found, p_WP, _ = physics.advance(*given)
    assert (found[[0, 2]] == expected[[0, 2]]).all()
    assert 0 < np.abs(found[1] - expected[1]).max() < 1e-3  # two half steps instead of one
    assert np.allclose(p_WP[:, 0], given[3][:, 0] * H, atol=1e-15)

    def never(*_, **named):
        raise SolverError("none", worlds=(0,))

    monkeypatch.setattr(Stepper, "roll", never)
    with pytest.raises(SolverError):
        physics.advance(*given)


def test_worlds_without_any_solution_are_named_among_all(one, monkeypatch):
    theta = tuple(np.repeat(values, 4, axis=0) for values in one._checked.Eval(one.CreateDefaultContext())[1])
    state = np.tile(one.CreateDefaultContext().get_discrete_state(0).value(), (4, 1))
    v_WP = np.array([[0.1, 0, 0], [0.15, 0, 0], [0.2, 0, 0], [0.15, 0, 0]])
    roll = Stepper.roll

    def refuse(self, theta, state, V_WP, *others, **named):
        bad = np.flatnonzero(V_WP[0, :, 3] == 0.15)
        if len(bad):
            raise SolverError("world", worlds=tuple(bad))
        return roll(self, theta, state, V_WP, *others, **named)

    monkeypatch.setattr(Stepper, "roll", refuse)
    with pytest.raises(SolverError) as failure:
        one.physics.advance(theta, state, np.tile([0.0, 0, 10], (4, 1)), v_WP)
    assert failure.value.worlds == (1, 3)


def test_forces_of_a_world_without_a_solution_are_those_of_a_shorter_step(one, monkeypatch):
    context = one.CreateDefaultContext()
    one.get_input_port().FixValue(context, np.zeros(3))
    Simulator(one, context).AdvanceTo(0.1)

    def refuse(model, *given, **options):
        if model.time_step > 0.4 * H:
            raise SolverError("world", worlds=(0,))
        return inspect(model, *given, **options)

    monkeypatch.setattr(world_physics, "inspect", refuse)
    forces = one.GetOutputPort("contact_forces").Eval(context)
    # It came to rest in longer steps, so that a gap of 0.1 nm is left to be closed.
    assert np.abs(forces.f_W.sum(axis=0) - [0, 0, 9.81]).max() < 1e-3


@pytest.mark.parametrize(
    ("state", "message"),
    [(np.full(13, np.nan), "finite"), (np.r_[2.0, np.zeros(12)], "unit"), (np.r_[1.0, np.zeros(12)], "world")],
)
def test_wrong_states_are_refused(one, state, message):
    context = one.CreateDefaultContext()
    with pytest.raises(StateError, match=message):
        one.SetState(context, state, np.zeros(3), world=5 if message == "world" else 0)
