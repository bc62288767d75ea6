# SPDX-License-Identifier: MIT
import dataclasses
from functools import cache

import numpy as np
import pytest
import torch
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from pinwm_drake.cousins.cousin import Cousins, draw_cousins
from pinwm_drake.errors import ParameterError, StateError
from pinwm_drake.systems.engines.twin.domains import SetCousins, SetDomain
from pinwm_drake.systems.engines.twin.world_model import WorldModel
from pinwm_drake.systems.scenario.schema import Scenario, Start, Theta, View
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.station.station import make_station
from tests.rendering.scenes import cloud
from tests.twin.samples import cube_twin

H = 1 / 240
NAMES = ("mass", "inertia", "friction", "restitution")


@cache
def setup_of(num_worlds: int) -> Setup:
    return make_setup(
        Scenario(
            object="t_block",
            theta=Theta(friction_floor=0.1, friction_pusher=0.2),
            camera=View(width=64, height=64),
            start=Start(pusher_angle=[3.0, 3.0], pusher_gap=[0.0, 0.0]),
            num_worlds=num_worlds,
        )
    )


@cache
def world_model() -> WorldModel:
    return WorldModel(setup_of(3))


def cousins_of(delta: float = 0.5, n: int = 3) -> Cousins:
    return draw_cousins(setup_of(3).twin, n, delta)


def pushed(world: WorldModel) -> Context:
    """A context in which every pusher moves towards its object."""
    context = world.CreateDefaultContext()
    world.get_input_port().FixValue(context, np.tile([0.4, 0.05, 0.0], world.num_worlds))
    return context


def outcome(world: WorldModel, context: Context) -> tuple[np.ndarray, np.ndarray]:
    """Objects (W, 13) after a push, and pictures before it."""
    pictures = world.GetOutputPort("rgb_batch").Eval(context).copy()
    Simulator(world, context).AdvanceTo(72 * H)
    return world.GetOutputPort("object_state").Eval(context).reshape(-1, 13).copy(), pictures


def test_a_cousins_context_moves_differently_and_looks_different():
    world = world_model()
    twin_moved, twin_seen = outcome(world, pushed(world))
    context = pushed(world)
    SetCousins(world, context, cousins_of())
    moved, seen = outcome(world, context)
    assert (twin_moved == twin_moved[0]).all()
    for k in range(3):
        for other in (twin_moved[0], moved[(k + 1) % 3]):
            assert np.abs(moved[k, 4:6] - other[4:6]).max() > 5e-4  # of some 40 mm
        for other in (twin_seen[0], seen[(k + 1) % 3]):
            assert np.abs(seen[k].astype(int) - other).max() > 20
        assert (seen[k, ..., 3] == twin_seen[0, ..., 3]).all()  # it has the same outline


def test_each_world_is_what_a_station_of_that_cousin_is():
    world, cousins = world_model(), cousins_of()
    context = pushed(world)
    SetCousins(world, context, cousins)
    moved, seen = outcome(world, context)
    alone = WorldModel(make_setup(setup_of(1).scenario, twin=cousins[1].twin()))
    one_moved, one_seen = outcome(alone, pushed(alone))
    assert (moved[1] == one_moved[0]).all()
    assert (seen[1] == one_seen[0]).all()


def test_without_delta_it_is_the_twin_bit_by_bit():
    world = world_model()
    expected = outcome(world, pushed(world))
    context = pushed(world)
    SetCousins(world, context, cousins_of(0.0))
    assert all((found == wanted).all() for found, wanted in zip(outcome(world, context), expected, strict=True))


def test_one_world_is_replaced_and_the_others_go_on():
    world, cousins = world_model(), cousins_of(n=4)
    context = pushed(world)
    SetCousins(world, context, draw_cousins(setup_of(3).twin, 3, 0.5))
    before, seen = world.GetParameters(context), world.GetOutputPort("rgb_batch").Eval(context).copy()
    copy = context.Clone()
    SetDomain(world, context, cousins[3], 1)
    after, now = world.GetParameters(context), world.GetOutputPort("rgb_batch").Eval(context)
    for name in NAMES:
        old, new = getattr(before, name), getattr(after, name)
        assert torch.equal(old[[0, 2]], new[[0, 2]])
        assert torch.equal(new[1], getattr(cousins[3].parameters(world.physics.scene), name)[0])
    assert not torch.equal(before.friction[1], after.friction[1])
    assert (now[[0, 2]] == seen[[0, 2]]).all()
    assert (now[1] != seen[1]).any()
    # Neither a copy of the context nor the cousins that it was made of have changed.
    assert (world.GetOutputPort("rgb_batch").Eval(copy) == seen).all()
    SetDomain(world, copy, cousins[3], 1)
    assert (world.GetOutputPort("rgb_batch").Eval(copy) == now).all()
    again = pushed(world)
    SetCousins(world, again, draw_cousins(setup_of(3).twin, 3, 0.5))
    assert (world.GetOutputPort("rgb_batch").Eval(again) == seen).all()


def test_one_cousin_for_one_world_of_the_default_context_or_for_all():
    world, cousin = world_model(), cousins_of()[0]
    context = pushed(world)
    seen = world.GetOutputPort("rgb_batch").Eval(context).copy()
    SetDomain(world, context, cousin, 2)
    now = world.GetOutputPort("rgb_batch").Eval(context).copy()
    assert (now[:2] == seen[:2]).all()
    assert (now[2] != seen[2]).any()
    SetDomain(world, context, cousin)
    everywhere = world.GetOutputPort("rgb_batch").Eval(context)
    assert (everywhere == now[2]).all()
    assert torch.equal(world.GetParameters(context).mass, torch.full((3, 1), cousin.theta["mass"], dtype=torch.float64))
    assert (world.GetOutputPort("rgb_batch").Eval(pushed(world)) == seen).all()


def test_a_cousin_may_keep_the_twins_colours():
    world, cousin = world_model(), dataclasses.replace(cousins_of()[0], looks=None)  # which are not even drawn
    context = pushed(world)
    seen = world.GetOutputPort("rgb_batch").Eval(context).copy()
    SetDomain(world, context, cousin, 1, colors=False)
    assert (world.GetOutputPort("rgb_batch").Eval(context) == seen).all()
    assert float(world.GetParameters(context).mass[1, 0]) == cousin.theta["mass"]


def test_what_was_set_belongs_to_the_context():
    world, sh = world_model(), cousins_of().sh()
    kept, first, second = sh.clone(), pushed(world), pushed(world)
    for context in (first, second):
        world.SetColors(context, sh)
    seen = world.GetOutputPort("rgb_batch").Eval(second).copy()
    world.SetColors(first, torch.zeros_like(sh[0]), 0)
    assert torch.equal(sh, kept)
    world.SetColors(second, sh)
    assert (world.GetOutputPort("rgb_batch").Eval(second) == seen).all()


def test_a_stations_context_takes_cousins():
    station = make_station(setup_of(1), "twin")
    context = station.CreateDefaultContext()
    seen = station.GetOutputPort("rgb").Eval(context).data.copy()
    SetDomain(station.world, context, cousins_of()[0], 0)
    assert (station.GetOutputPort("rgb").Eval(context).data != seen).any()
    mine = station.world.GetMyContextFromRoot(context)
    assert float(station.world.GetParameters(mine).friction[0, 0]) == cousins_of()[0].theta["friction_floor"]


def test_what_does_not_fit_is_refused(tmp_path):
    world = world_model()
    context = pushed(world)
    for number in (2, 4):
        with pytest.raises(ParameterError, match=f"cousins: got {number}; allowed: 3, one for each world"):
            SetCousins(world, context, cousins_of(n=number))
    for number in (-1, 3):
        with pytest.raises(StateError, match=f"world: got {number}; allowed: 0 to 2"):
            SetDomain(world, context, cousins_of()[0], number)
    stranger = draw_cousins(cube_twin(tmp_path, surfels=cloud(20)), 1)[0]
    with pytest.raises(ParameterError, match="sh: got"):
        SetDomain(world, context, stranger, 0)
    with pytest.raises(ParameterError, match="sh: got"):
        world.SetColors(context, cousins_of().sh(), 0)
