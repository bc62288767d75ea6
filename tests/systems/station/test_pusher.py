# SPDX-License-Identifier: MIT
"""The pusher of a station and the forces of contact, with every engine."""

import numpy as np
import pytest

from pinwm_drake.systems.scenario.schema import ENGINES
from tests.systems.stations import (
    FRICTION,
    HIGH,
    LOW,
    MASS,
    REST,
    TURNED,
    after,
    moved,
    output,
    started,
    station_of,
    translated,
)

WEIGHT = 9.81 * MASS  # N


@pytest.mark.parametrize("engine", ENGINES)
def test_the_floor_bears_the_weight(engine):
    station = station_of(engine)
    context = started(station, TURNED)
    after(station, context, 24)
    forces = output(station, context, "contact_forces")
    assert set(forces.pairs) == {"object-floor"}
    assert forces.f_W.shape == forces.p_WC.shape == (len(forces.pairs), 3)
    assert np.abs(forces.f_W.sum(axis=0) - [0, 0, WEIGHT]).max() < 1e-4 * WEIGHT
    # Their middle is below the centre of mass.
    load = forces.f_W[:, 2]
    assert np.abs(load @ forces.p_WC[:, :2] / load.sum() - TURNED.translation()[:2]).max() < 1e-4
    assert np.abs(forces.p_WC[:, 2]).max() < 1e-3


@pytest.mark.parametrize("engine", ENGINES)
def test_a_pusher_presses_with_friction_along(engine):
    station = station_of(engine)
    context = started(station, REST, np.array([0.0, -0.066, 0.025]))
    station.get_input_port().FixValue(context, [0.0, 0.1, 0.0])
    after(station, context, 48)
    forces = output(station, context, "contact_forces")
    assert set(forces.pairs) == {"object-floor", "object-pusher"}
    pushed = np.array([pair == "object-pusher" for pair in forces.pairs])
    # At constant speed the pusher bears the floor's friction: mu m g.
    assert forces.f_W[pushed].sum(axis=0)[1] == pytest.approx(WEIGHT * FRICTION, rel=0.03)
    assert np.abs(forces.f_W.sum(axis=0)[:2]).max() < 0.03 * WEIGHT * FRICTION
    assert output(station, context, "object_state")[11] == pytest.approx(0.1, rel=0.01)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_velocity_moves_the_pusher(engine):
    station = station_of(engine)
    context = started(station)
    after(station, context, 12)
    station.get_input_port().FixValue(context, [0.1, -0.05, 0.02])
    end = after(station, context, 24)[13:]
    near = 1e-6 if engine == "twin" else 1e-5
    assert np.abs(end - [*moved(0.01, -0.005, 0.002), 0.1, -0.05, 0.02]).max() < near


@pytest.mark.parametrize("engine", ENGINES)
def test_a_translation_moves_the_pusher(engine):
    station = translated(engine)
    assert station.get_input_port().get_name() == "pusher_translation_W"
    context = started(station)
    station.get_input_port().FixValue(context, [0.02, 0.0, 0.0])
    near = 1e-6 if engine == "twin" else 1e-5
    assert np.abs(after(station, context, 24)[13:16] - moved(0.02, 0, 0)).max() < near
    station.get_input_port().FixValue(context, [0.0, -0.03, 0.01])
    assert np.abs(after(station, context, 24)[13:16] - moved(0.02, -0.03, 0.01)).max() < near
    station.get_input_port().FixValue(context, np.zeros(3))
    assert np.abs(after(station, context, 12)[13:16] - moved(0.02, -0.03, 0.01)).max() < near


@pytest.mark.parametrize("engine", ENGINES)
def test_limits(engine):
    station, near = station_of(engine), 1e-6 if engine == "twin" else 1e-5
    context = started(station, REST, np.array([0.0, 0.39, 0.02]))
    station.get_input_port().FixValue(context, [3.0, 0.0, 0.0])  # six times too fast
    assert np.abs(after(station, context, 12)[13:16] - [0.025, 0.39, 0.02]).max() < near
    station.get_input_port().FixValue(context, [0.0, 0.4, -0.3])  # the wall is 6 periods away, and the floor 8
    assert np.abs(after(station, context, 12)[13:16] - [0.025, HIGH[1], LOW[2]]).max() < near
    station.get_input_port().FixValue(context, [-0.4, 0.0, np.nan])
    assert np.abs(after(station, context, 6)[13:16] - [0.025, HIGH[1], LOW[2]]).max() < near
    context = started(translated(engine))
    translated(engine).get_input_port().FixValue(context, [0.3, 0.0, 0.0])
    assert np.abs(after(translated(engine), context, 24)[13:16] - moved(0.05, 0, 0)).max() < near
