# SPDX-License-Identifier: MIT
"""Diagrams are freed with what made them: a process that makes many does not grow."""

import gc
import weakref

import numpy as np
import pytest

from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.ports import free_with
from pinwm_drake.systems.station.station import make_station


@pytest.mark.parametrize("engine", ["twin", "hydroelastic"])
def test_the_diagram_of_an_environment_is_freed_with_it(engine):
    env = TaskEnv("push_t", engine)
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, np.float32))
    station = weakref.ref(env.unwrapped.worlds.run.station)
    systems = [weakref.ref(system) for system in station().GetSystems()]
    del env
    gc.collect()
    assert station() is None
    assert [system() for system in systems] == [None] * len(systems)


def test_a_station_lives_as_long_as_its_owner():
    class Owner:
        pass

    owner, station = Owner(), make_station("push_t", "twin")
    free_with(owner, station)
    context = station.CreateDefaultContext()
    assert np.isfinite(station.GetOutputPort("object_state").Eval(context)).all()
    system = weakref.ref(station)
    del station, context
    gc.collect()
    assert system() is not None
    del owner
    gc.collect()
    assert system() is None
