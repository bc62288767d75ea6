# SPDX-License-Identifier: MIT
import dataclasses
import math

import numpy as np
import pytest
import torch
import trimesh
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.rendering.silhouette import coverage
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.systems.engines.plant.engine import AddPlantEngine
from pinwm_drake.systems.scenario.schema import Scenario, Start
from pinwm_drake.systems.scenario.setup import make_setup
from pinwm_drake.systems.sdf.contact import SUPPORT_RADIUS
from tests.systems.scenes import GRAVITY, setup_of
from tests.twin.samples import cube_twin, estimates

CONTACTS = ["hydroelastic", "point"]
PORTS = ("object_state", "pusher_state", "rgb", "contact_forces")
REST = np.zeros(6)


class Bench:
    """An engine in a diagram of its own, inside another diagram."""

    def __init__(self, setup, contact):
        self.setup, builder, outer = setup, DiagramBuilder(), DiagramBuilder()
        self.engine = AddPlantEngine(builder, setup, contact)
        for name in PORTS:
            builder.ExportOutput(getattr(self.engine, name), name)
        builder.ExportInput(self.engine.pusher_velocity, "velocity")
        self.inner = outer.AddSystem(builder.Build())
        outer.ExportInput(self.inner.GetInputPort("velocity"), "velocity")
        for name in PORTS:
            outer.ExportOutput(self.inner.GetOutputPort(name), name)
        self.diagram = outer.Build()

    def start(self, X_WO=None, V_WO=REST, p_WP=(0.0, 0.0, 50.0)):
        simulator = Simulator(self.diagram)
        context = simulator.get_mutable_context()
        if X_WO is not None:
            self.engine.handle.SetObjectState(context, X_WO, V_WO)
            self.engine.handle.SetPusherPosition(context, np.array(p_WP))
        self.push(simulator, np.zeros(3))
        return simulator

    def push(self, simulator, v_WP):
        self.diagram.GetInputPort("velocity").FixValue(simulator.get_mutable_context(), v_WP)

    def read(self, simulator, name):
        return self.diagram.GetOutputPort(name).Eval(simulator.get_context())


@pytest.fixture(scope="module", params=CONTACTS)
def t_block(request):
    return Bench(setup_of("t_block", 0.1), request.param)


def resting(bench):
    """Where the T-block of a bench stands, m."""
    return 0.025 + (SUPPORT_RADIUS if bench.engine.name == "point" else 0)


def test_by_default_things_are_in_the_middle_of_the_start(t_block):
    start = Start(x=[0.0, 0.1], y=[0.2, 0.2], yaw=[0.5, 0.7], pusher_angle=[0.0, 0.0], pusher_height=0.03)
    theta = t_block.setup.scenario.theta
    bench = Bench(make_setup(Scenario(object="t_block", theta=theta, start=start)), t_block.engine.name)
    simulator = bench.start()
    state = bench.read(simulator, "object_state")
    yaw = 2 * math.atan2(state[3], state[0])
    np.testing.assert_allclose([yaw, *state[4:]], [0.6, 0.05, 0.2, 0.025, *REST], atol=1e-9)
    p_WP = bench.read(simulator, "pusher_state")
    assert p_WP[0] > 0.1
    np.testing.assert_allclose(p_WP[1:], [0.2, 0.03, 0, 0, 0], atol=1e-9)
    simulator.AdvanceTo(bench.setup.period)
    np.testing.assert_allclose(bench.read(simulator, "pusher_state"), p_WP, atol=1e-9)


def test_states_are_those_that_were_set(t_block):
    X_WO, V_WO = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.1, 0.2, 0.3]), np.arange(1.0, 7.0)
    simulator = t_block.start(X_WO, V_WO, [0.4, 0.5, 0.6])
    expected = [*X_WO.rotation().ToQuaternion().wxyz(), 0.1, 0.2, 0.3, *V_WO]
    np.testing.assert_allclose(t_block.read(simulator, "object_state"), expected, atol=1e-12)
    np.testing.assert_array_equal(t_block.read(simulator, "pusher_state"), [0.4, 0.5, 0.6, 0, 0, 0])
    with pytest.raises(ParameterError, match="world: got 1"):
        t_block.engine.handle.SetPusherPosition(simulator.get_mutable_context(), np.zeros(3), world=1)


def test_the_pusher_follows_its_velocity_to_the_micrometre_and_pushes(t_block):
    simulator = t_block.start(RigidTransform([0, 0, resting(t_block)]), p_WP=[0.0, -0.075, 0.025])
    generator, p_WP, T = np.random.default_rng(0), np.array([0.0, -0.075, 0.025]), t_block.setup.period
    for k in range(36):
        v = np.array([0.02 * generator.uniform(-1, 1), 0.15 + 0.05 * generator.uniform(-1, 1), 0.0])
        t_block.push(simulator, v)
        simulator.AdvanceTo((k + 1) * T)
        p_WP = p_WP + T * v
        # The drive is as stiff as 1e7 N/m and 1e5 N s/m; an impact is a few hundred newtons for a millisecond.
        at = t_block.read(simulator, "pusher_state")
        np.testing.assert_allclose(at[:3], p_WP, atol=5e-6)
        np.testing.assert_allclose(at[3:], v, atol=5e-3)
    assert t_block.read(simulator, "object_state")[5] == pytest.approx(p_WP[1] + 0.065, abs=2e-3)


@pytest.mark.parametrize("contact", CONTACTS)
def test_a_sliding_object_stops_after_v2_over_2_mu_g(contact):
    # Pairs with different friction, none of them that of the object's surface alone.
    bench, v = Bench(setup_of("cube", 0.15, pusher_friction=0.6), contact), 0.15
    simulator = bench.start(RigidTransform([0, 0, 0.03 + (SUPPORT_RADIUS if contact == "point" else 0)]))
    simulator.AdvanceTo(0.05)
    at = bench.read(simulator, "object_state")[4:7]
    bench.engine.handle.SetObjectState(simulator.get_mutable_context(), RigidTransform(at), [0, 0, 0, v, 0, 0])
    simulator.AdvanceTo(0.05 + v / (0.15 * GRAVITY) + 0.02)
    state, h = bench.read(simulator, "object_state"), bench.setup.plant_time_step
    moved = state[4] - at[0] + 0.5 * v * h
    assert moved == pytest.approx(v**2 / (2 * 0.15 * GRAVITY), rel=7e-3)
    # It neither sinks nor creeps.
    assert abs(state[6] - at[2]) < 1e-7
    assert np.linalg.norm(state[10:]) < 1e-5


def test_forces_carry_the_weight_and_push(t_block):
    simulator = t_block.start(RigidTransform([0, 0, resting(t_block)]))
    simulator.AdvanceTo(0.1)
    forces = t_block.read(simulator, "contact_forces")
    assert set(forces.pairs) == {"object-floor"}
    np.testing.assert_allclose(forces.f_W.sum(axis=0), [0, 0, GRAVITY], atol=1e-3)
    np.testing.assert_allclose(forces.p_WC[:, 2], 0, atol=2e-5)
    assert forces.worlds.tolist() == [0] * len(forces.pairs)
    simulator = t_block.start(RigidTransform([0, 0, resting(t_block)]), p_WP=[0.0, -0.0651, 0.025])
    t_block.push(simulator, [0, 0.05, 0])
    simulator.AdvanceTo(0.15)
    forces = t_block.read(simulator, "contact_forces")
    hand = np.array([pair == "object-pusher" for pair in forces.pairs])
    # A steady push through the centre of mass: what friction with the floor, 0.1 of the weight, takes.
    np.testing.assert_allclose(forces.f_W[hand].sum(axis=0)[1], 0.1 * GRAVITY, rtol=0.02)
    np.testing.assert_allclose(forces.f_W.sum(axis=0)[:2], 0, atol=0.02)
    edge = t_block.read(simulator, "object_state")[5] - 0.055
    np.testing.assert_allclose(forces.p_WC[hand], [[0, edge, 0.025]], atol=2e-4)


def test_there_are_no_forces_in_the_air(t_block):
    simulator = t_block.start(RigidTransform([0, 0, 1]))
    forces = t_block.read(simulator, "contact_forces")
    assert (forces.pairs, forces.f_W.shape, forces.p_WC.shape) == ((), (0, 3), (0, 3))


def test_the_picture_shows_the_object_where_the_camera_sees_it(t_block):
    X_WO = RigidTransform(RollPitchYaw(0, 0, 0.4), [0.02, 0.03, 0.025])
    simulator = t_block.start(X_WO)
    picture = np.array(t_block.read(simulator, "rgb").data)
    shown = picture[..., 3] == 255
    assert picture.shape == (128, 128, 4)
    assert (picture[~shown] == [255, 255, 255, 0]).all()
    X_CO = t_block.setup.X_WC.inverse() @ X_WO
    pose = Pose(torch.tensor(X_CO.rotation().ToQuaternion().wxyz()), torch.tensor(X_CO.translation()))
    mesh = load_mesh(t_block.setup.twin.mesh_path)
    parts = coverage(mesh, t_block.setup.camera.scaled(3), pose).numpy().reshape(128, 3, 128, 3).mean(axis=(1, 3))
    assert shown.sum() > 300
    assert (shown != (parts >= 0.5)).sum() <= 2
    # The pusher hides it.
    between = X_WO.translation() + 0.2 * (t_block.setup.X_WC.translation() - X_WO.translation())
    t_block.engine.handle.SetPusherPosition(simulator.get_mutable_context(), between)
    hidden = np.array(t_block.read(simulator, "rgb").data)[..., 3] == 255
    assert (shown & ~hidden).sum() > 20
    assert not (hidden & ~shown).any()


def test_a_copy_of_a_context_goes_on_alike(t_block):
    simulator = t_block.start(RigidTransform([0, 0, resting(t_block)]), p_WP=[0.02, -0.067, 0.025])
    t_block.push(simulator, [0, 0.2, 0])
    simulator.AdvanceTo(0.021)
    other = Simulator(t_block.diagram, simulator.get_context().Clone())
    for each in (simulator, other):
        each.AdvanceTo(0.05)
    assert np.abs(t_block.read(simulator, "object_state")[9]) > 0.1
    for name in ("object_state", "pusher_state"):
        np.testing.assert_array_equal(t_block.read(simulator, name), t_block.read(other, name))


@pytest.mark.parametrize("contact", CONTACTS)
def test_a_twins_floor_centre_of_mass_and_gravity_count(contact, tmp_path):
    # A box beside the origin of its mesh on a high floor and a small planet, pushed by a mesh.
    beside, sides = np.array([0.05, -0.04, 0.1]), (0.06, 0.05, 0.04)
    box = trimesh.creation.box(sides)
    box.apply_translation(beside)
    box.export(tmp_path / "box.obj")
    trimesh.creation.box((0.02, 0.02, 0.02)).export(tmp_path / "hand.obj")
    moments = np.diag(mass_properties(box, mass=0.5).inertia)
    theta = estimates(mass=0.5, **{f"inertia_{2 * axis}": float(m) for axis, m in zip("xyz", moments, strict=True)})
    twin = cube_twin(
        tmp_path,
        mesh_path=tmp_path / "box.obj",
        pusher=PusherGeometry(tmp_path / "hand.obj", None),
        floor_height=0.2,
        gravity=4.0,
        theta=theta,
    )
    bench = Bench(make_setup(Scenario(), twin=twin), contact)
    stands = 0.2 + 0.02 - 0.1 + (SUPPORT_RADIUS if contact == "point" else 0)
    # It slides and turns: the centre of mass goes straight, the origin does not.
    v, w = 0.1, 3.0
    V_WO = np.array([0, 0, w, *(np.array([v, 0, 0]) - np.cross([0, 0, w], beside))])
    simulator = bench.start(RigidTransform([0, 0, stands]), V_WO)
    simulator.AdvanceTo(0.02)
    state = bench.read(simulator, "object_state")
    turned = 2 * math.atan2(state[3], state[0])
    p_WB = state[4:7] + RigidTransform(RollPitchYaw(0, 0, turned), [0, 0, 0]) @ beside
    assert 0.03 < turned < 0.06
    # Friction of one that slides and turns is not all backwards: 0.03 mm. About the origin it would be 2 mm.
    np.testing.assert_allclose(p_WB[1:], [beside[1], 0.22 + stands - 0.12], atol=1e-4)
    assert 0.0015 < p_WB[0] - beside[0] < 0.002
    simulator.AdvanceTo(0.4)
    forces = bench.read(simulator, "contact_forces")
    np.testing.assert_allclose(forces.f_W.sum(axis=0), [0, 0, 0.5 * 4.0], atol=1e-3)
    np.testing.assert_allclose(forces.p_WC[:, 2], 0.2, atol=2e-5)


def test_theta_of_a_setup_is_that_of_the_plant():
    setup = setup_of("cube", 0.1, pusher=PusherShape("cylinder", 0.012, 0.05)).with_theta(mass=0.4, inertia_zz=3e-4)
    for contact in CONTACTS:
        parts = AddPlantEngine(DiagramBuilder(), setup, contact).handle.parts
        inertia = parts.object.default_spatial_inertia()
        assert inertia.get_mass() == 0.4
        assert inertia.CalcRotationalInertia().get_moments()[2] == pytest.approx(3e-4, rel=1e-9)
        (hand,) = parts.plant.GetCollisionGeometriesForBody(parts.pusher)
        shape = parts.scene_graph.model_inspector().GetShape(hand)
        assert (shape.radius(), shape.length()) == (0.012, 0.05)


def test_the_time_step_of_a_scenario_is_that_of_the_plant():
    setup = dataclasses.replace(setup_of("cube", 0.1), plant_time_step=1 / 4800)
    parts = AddPlantEngine(DiagramBuilder(), setup, "point").handle.parts
    assert parts.plant.time_step() == pytest.approx(1 / 4800, rel=1e-11)
