# SPDX-License-Identifier: MIT
"""Every engine behind the station: the same ports, the same motion."""

import numpy as np
import pytest
from pydrake.common import RandomGenerator
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem, PortDataType

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.engines.engine import ContactForces
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.runs.episode import Episode, Record
from pinwm_drake.systems.scenario.schema import ENGINES
from pinwm_drake.systems.scenario.setup import make_setup
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import make_station
from tests.systems.stations import REST, TURNED, H, after, output, scenario, setup_of, started, station_of

PLANTS = ENGINES[1:]
POINT_DAILY = [pytest.param(name, marks=pytest.mark.nightly) if name == "hydroelastic" else name for name in ENGINES]
# Beside the middle of the bar, so that the object turns; it slides on for some 7 mm.
PUSH = StraightPush(np.array([0.03, -0.075, 0.025]), np.array([0.0, 1.0, 0.0]), 0.12, 0.04, 10.0)


@pytest.fixture(scope="module")
def episodes() -> dict[str, Episode]:
    return {engine: Episode(make_station(setup_of(), engine)) for engine in ENGINES}


@pytest.fixture(scope="module")
def records(episodes: dict[str, Episode]) -> dict[str, Record]:
    """The same push through every engine."""
    found = {}
    for engine, episode in episodes.items():
        episode.begin(Place(REST, PUSH.p_WP), PUSH)
        found[engine] = episode.run()
    return found


@pytest.mark.parametrize("engine", ENGINES)
def test_ports(engine):
    station = station_of(engine)
    assert station.num_input_ports() == 1
    assert (station.get_input_port().get_name(), station.get_input_port().size()) == ("pusher_velocity_W", 3)
    ports = [station.get_output_port(k) for k in range(station.num_output_ports())]
    found = {port.get_name(): port.size() if port.get_data_type() == PortDataType.kVectorValued else None
             for port in ports}  # fmt: skip
    expected = {"object_state": 13, "pusher_state": 6, "rgb_time": 1, "pusher_time": 1}
    expected |= dict.fromkeys(("rgb", "rgb_batch", "fault", "contact_forces", "query_object"))
    assert found == expected
    context = started(station)
    assert output(station, context, "rgb").data.shape == (80, 96, 4)
    assert (output(station, context, "rgb_batch")[0] == output(station, context, "rgb").data).all()
    assert isinstance(output(station, context, "contact_forces"), ContactForces)
    context.SetTime(0.25)
    assert output(station, context, "rgb_time") == output(station, context, "pusher_time") == [0.25]
    assert output(station, context, "fault") == ""


@pytest.mark.parametrize("engine", ENGINES)
def test_the_place_is_where_it_was_put(engine):
    station = station_of(engine)
    context = started(station, TURNED, np.array([0.1, 0.2, 0.03]))
    assert station.object_pose(context).IsNearlyEqualTo(TURNED, 1e-12)
    state = output(station, context, "object_state")
    assert np.abs(state[4:7] - TURNED.translation()).max() < 1e-15
    assert (state[7:] == 0).all()
    assert np.abs(output(station, context, "pusher_state") - [0.1, 0.2, 0.03, 0, 0, 0]).max() < 1e-15
    V_WO = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    station.engine.handle.SetObjectState(context, TURNED, V_WO)
    assert np.abs(output(station, context, "object_state")[7:] - V_WO).max() < 1e-12


def test_one_push_through_every_engine(records):
    twin = records["twin"]
    assert np.linalg.norm(twin.displacement) > 0.025
    assert np.degrees(twin.rotation) > 15
    for engine in PLANTS:
        other = records[engine]
        # The project's bounds. Needed: 1.5 mm and 0.5°, nearly all of it due to the twin's 8 friction directions.
        assert np.linalg.norm(twin.displacement - other.displacement) < 0.003
        share = abs(twin.quaternions()[-1] @ other.quaternions()[-1])
        assert np.degrees(2 * np.arccos(min(share, 1.0))) < 2.0
    for record in records.values():
        assert record.at_rest
        # The very same motion of the pusher.
        rows = min(len(record.t), len(twin.t))
        assert np.abs(record.pusher_state[:rows, :3] - twin.pusher_state[:rows, :3]).max() < 1e-5
        assert np.abs(record.pusher_state[-1] - [0.03, -0.035, 0.025, 0, 0, 0]).max() < 1e-9


@pytest.mark.parametrize("engine", ENGINES)
def test_a_clone_and_a_restored_context_go_on_bit_by_bit(episodes, records, engine):
    episode, rows = episodes[engine], (30, 42)  # the pusher touches the object in both
    expected = records[engine]
    episode.begin(Place(REST, PUSH.p_WP), PUSH)
    episode.simulator.AdvanceTo(rows[0] * H)
    original = episode.simulator.get_context()
    contexts = [original.Clone(), episode.diagram.CreateDefaultContext()]
    contexts[1].SetTimeStateAndParametersFrom(original)
    for context in contexts:
        simulator = Simulator(episode.diagram, context)
        simulator.AdvanceTo(rows[1] * H)
        mine = episode.station.GetMyContextFromRoot(context)
        assert (output(episode.station, mine, "object_state") == expected.object_state[rows[1]]).all()
        assert (output(episode.station, mine, "pusher_state") == expected.pusher_state[rows[1]]).all()
    assert np.abs(expected.object_state[rows[1]] - expected.object_state[rows[0]]).max() > 1e-3


@pytest.mark.parametrize("engine", POINT_DAILY)
def test_the_same_seed_is_the_same_trajectory(engine):
    ends = []
    for station, seed, periods in (
        (station_of(engine), 3, 24),
        (make_station(setup_of(), engine), 3, 24),
        (station_of(engine), 4, 0),
    ):
        context = station.CreateDefaultContext()
        station.SetRandomContext(context, RandomGenerator(seed))
        p_WO, p_WP = output(station, context, "object_state")[4:7], output(station, context, "pusher_state")[:3]
        towards = (p_WO - p_WP) * [1.0, 1.0, 0.0]
        station.get_input_port().FixValue(context, 0.5 * towards / np.linalg.norm(towards))
        first = p_WO.copy()
        ends.append(after(station, context, periods))
        if seed == 3:
            assert np.linalg.norm(ends[-1][4:7] - first) > 1e-3  # it was pushed
    assert (ends[0] == ends[1]).all()
    assert np.abs(ends[0] - ends[2]).max() > 1e-3


def test_what_cannot_be():
    with pytest.raises(ParameterError, match="engine: got 'bullet'; allowed: twin, hydroelastic, point"):
        make_station(setup_of(), "bullet")
    with pytest.raises(ParameterError, match="command: got 'force'; allowed: velocity, translation"):
        make_station(setup_of(), "twin", command="force")
    many = make_setup(scenario(num_worlds=32))
    for engine in PLANTS:
        with pytest.raises(ParameterError, match=f"num_worlds: got 32 with {engine}; allowed: 1"):
            make_station(many, engine)


def test_many_worlds_of_the_twin():
    station = make_station(scenario(num_worlds=3))
    context = station.CreateDefaultContext()
    station.SetRandomContext(context, RandomGenerator(1))
    starts = output(station, context, "object_state").reshape(3, 13)
    assert len(np.unique(starts[:, 4])) == 3
    before = output(station, context, "pusher_state").reshape(3, 6)[:, :3].copy()
    station.get_input_port().FixValue(context, np.outer([0.1, 0.0, 9.0], [0.0, 0.0, 1.0]).ravel())
    Simulator(station, context).AdvanceTo(24 * H)
    way = output(station, context, "pusher_state").reshape(3, 6)[:, :3] - before
    assert np.abs(way - np.outer([0.01, 0.0, 0.05], [0, 0, 1])).max() < 1e-9
    assert output(station, context, "rgb_batch").shape == (3, 80, 96, 4)
    assert station.object_pose(context, 2).IsNearlyEqualTo(
        RigidTransform(station.object_pose(context, 2).rotation(), starts[2, 4:7]), 1e-4
    )


class Follow(LeafSystem):
    """Pushes along y until the object is far enough."""

    def __init__(self, target: float) -> None:
        super().__init__()
        self._target = target
        self._state = self.DeclareVectorInputPort("object_state", 13)
        self.DeclareVectorOutputPort("v", 3, self._Calc, {self._state.ticket()})

    def _Calc(self, context, output) -> None:
        left = self._target - self._state.Eval(context)[5]
        output.SetFromVector([0.0, np.clip(8.0 * left, 0.0, 0.15), 0.0])


@pytest.mark.parametrize("engine", POINT_DAILY)
def test_a_controller_closes_the_loop(engine):
    builder = DiagramBuilder()
    station = builder.AddSystem(make_station(setup_of(), engine))
    follow = builder.AddSystem(Follow(0.01))
    builder.Connect(station.GetOutputPort("object_state"), follow.get_input_port())
    builder.Connect(follow.get_output_port(), station.get_input_port())
    diagram = builder.Build()  # which refuses algebraic loops
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    station.SetPlace(context, Place(REST, np.array([0.0, -0.066, 0.025])))
    simulator.AdvanceTo(96 * H)
    y = station.object_pose(context).translation()[1]
    assert 0.008 < y < 0.012
    # Held for one period, and as the controller says.
    v_WP = station.GetOutputPort("pusher_state").Eval(station.GetMyContextFromRoot(context))[3:]
    assert v_WP[1] == pytest.approx(np.clip(8 * (0.01 - y), 0, 0.15), abs=2e-3)
