# SPDX-License-Identifier: MIT
import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from pinwm_drake.cousins.domain import CousinDomains
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds, training_options
from pinwm_drake.systems.mpc import waypoints as search
from pinwm_drake.systems.mpc.waypoints import WaypointOptions, find_waypoints
from pinwm_drake.tasks.waypoints import WAYPOINTS_FILE, Waypoints

QUICK = WaypointOptions(strokes=128, sieves=((1, 16), (8, 4)), attempts=2, replays=2, rounds=2, plans=4, starts=8)


@pytest.fixture(scope="module")
def worlds():
    return TrainingWorlds("flip_cube", training_options(image_size=16), num_worlds=16, domains=CousinDomains())


@pytest.fixture(scope="module")
def found(worlds, tmp_path_factory):
    """Waypoints of a search, its folder, and what it reported."""
    folder, steps = tmp_path_factory.mktemp("search"), []
    return find_waypoints(worlds, folder, QUICK, seed=3, report=steps.append), folder, steps


def test_a_cube_is_turned_over_from_the_last_waypoints_by_nothing_but_letting_go(worlds, found):
    waypoints, _, _ = found
    assert len(waypoints) > 20
    env = worlds.worlds("state").worlds
    angles = env.task.measure(waypoints.object_state, waypoints.p_WP).angle
    assert angles.max() > 1.4  # of a cube that lies
    assert angles.min() < 0.5
    near = np.argsort(angles)[:16]
    env.reset()
    env.set_object_states(waypoints.object_state[near], waypoints.p_WP[near])
    success = np.zeros(16, bool)
    for _ in range(8):
        success |= env.advance(np.zeros((16, 3))).terminated
    assert success.sum() >= 8


def test_its_file_holds_what_was_found_and_how_robust_it_is(found):
    waypoints, folder, steps = found
    known = Waypoints.read(folder)
    assert known.digest() == waypoints.digest()
    with np.load(folder / WAYPOINTS_FILE) as file:
        assert file["share"] == steps[-1].best > 0.1
    assert [step.done for step in steps] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    assert len(Waypoints.read(folder / "nothing")) == 0


def test_the_plan_turns_the_cube_over_from_other_starts_with_noise_and_in_cousins(worlds, found):
    waypoints, _, _ = found
    env = worlds.worlds("state").worlds
    state = env.task.state(waypoints.object_state, waypoints.p_WP)
    begun = (waypoints.object_state[:, 7:] == 0.0).all(1)  # nothing has moved yet
    level = np.linalg.norm(state[:, 15:17], axis=1)
    start = env.setup.scenario.start
    begun &= np.abs(waypoints.p_WP[:, 2] - start.pusher_height) < 0.008
    begun &= level < level[begun].min() + 0.25  # not on a way around it
    away = state[begun, 15:18]
    assert len(np.unique(waypoints.object_state[begun, 4:6].round(3), axis=0)) > 5  # starts of its own each
    assert np.linalg.norm(waypoints.action, axis=1).max() <= 1.0 + 1e-9
    # Told along the heading, the first actions of all replays are one; the pusher's place is off by some millimetres.
    yaw = np.arctan2(away[:, 1], away[:, 0])
    x, y, z = waypoints.action[begun].T
    along = np.column_stack([np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x, z])
    assert np.ptp(yaw) > 0.5
    assert along.std(0).max() < 0.1


@pytest.mark.nightly
def test_rounds_make_a_plan_more_robust(worlds, tmp_path):
    shares = []
    for rounds in (0, 6):
        options = dataclasses.replace(QUICK, attempts=1, replays=8, rounds=rounds, plans=16, starts=16)
        find_waypoints(worlds, tmp_path, options, seed=3)
        with np.load(tmp_path / WAYPOINTS_FILE) as file:
            shares.append(float(file["share"]))
    assert shares[1] > shares[0] + 0.1 > 0.1


@pytest.mark.parametrize("after", [1, pytest.param(4, marks=pytest.mark.nightly)])
def test_an_interrupted_search_goes_on_with_the_same_result(worlds, found, tmp_path, after):
    class Killed(Exception):
        pass

    steps = []

    def kill(step):
        steps.append(step)
        if len(steps) == after:
            raise Killed

    with pytest.raises(Killed):
        find_waypoints(worlds, tmp_path, QUICK, seed=3, report=kill)
    assert find_waypoints(worlds, tmp_path, QUICK, seed=3, resume=True).digest() == found[0].digest()
    with pytest.raises(InputError, match="seed = 3"):
        find_waypoints(worlds, tmp_path, QUICK, seed=4, resume=True)


@pytest.mark.parametrize(
    "wrong", [{"attempts": 0}, {"replays": 0}, {"sieves": ()}, {"noise": -0.1}, {"rounds": -1}, {"plans": 1}]
)
def test_options_out_of_range_are_refused(wrong):
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        WaypointOptions(**wrong)


def test_waypoints_of_late_actions_keep_what_is_still_to_take_effect(tmp_path):
    options = training_options(image_size=16, latency=(0.1, 0.1))
    worlds = TrainingWorlds("flip_cube", options, num_worlds=16, domains=CousinDomains())
    waypoints = find_waypoints(worlds, tmp_path, dataclasses.replace(QUICK, rounds=0, attempts=1), seed=3)
    env = worlds.worlds("state").worlds
    depth = env.actions_before
    assert waypoints.past.shape == (len(waypoints), depth, 3)
    # An action late, the pusher makes the last translation that was asked for: there is another waypoint.
    after = waypoints.p_WP + env.run.max_translation * waypoints.past[:, 0]
    moves = np.linalg.norm(waypoints.past[:, 0], axis=1) > 0.1
    gaps = np.linalg.norm(after[moves][:, None] - waypoints.p_WP[None], axis=2).min(1)
    assert moves.sum() > 20
    assert np.mean(gaps < 1e-6) > 0.5
    # Episodes that begin in a waypoint go on with it.
    worlds.waypoints = waypoints
    env = worlds.worlds("state").worlds
    for world in range(env.num_worlds):
        env.set_generator(world, np.random.default_rng(world))
    env.begin(np.arange(env.num_worlds))
    rows = np.linalg.norm(env.run.p_WP[:, None] - waypoints.p_WP[None], axis=2)
    begun, row = rows.min(1) < 1e-9, rows.argmin(1)
    assert begun.sum() >= 6
    before = env.run.p_WP.copy()
    env.advance(np.zeros((env.num_worlds, 3)))
    moved = (env.run.p_WP - before) / env.run.max_translation
    off = np.linalg.norm(moved - waypoints.past[row, 0], axis=1)[begun]
    assert np.mean(off < 1e-6) > 0.5  # the others met the box's wall


@pytest.mark.parametrize(("success", "worth"), [(True, 1.5), (False, 0.0)])
def test_a_plan_that_ends_with_a_press_has_turned_nothing(worlds, monkeypatch, success, worth):
    def carried_out(replays, actions):
        W = len(actions)
        for reward, ended in ((2.0, False), (-0.5, True)):
            progress = SimpleNamespace(success=np.full(W, success and ended))
            out = SimpleNamespace(reward=np.full(W, reward), terminated=np.full(W, ended), progress=progress)
            yield np.ones(W, bool), out

    monkeypatch.setattr(search, "carried_out", carried_out)
    found = search._Search(worlds, QUICK, 3)._worth(np.zeros((1, 9, 3)), 4, 0.0, np.random.default_rng(0))
    assert found == pytest.approx(worth)


@pytest.mark.parametrize(
    ("shares", "kept", "levels"),
    [((0.3, 0.9, 0.9), 0.3, 1), ((0.05, 0.2, 0.9), 0.1, 2), ((0.0, 0.05, 0.4), 0.1, 3), ((0.0, 0.0, 0.0), 0.0, 3)],
)
def test_less_noise_is_tried_where_few_replays_do_the_task_and_counts_less(worlds, monkeypatch, shares, kept, levels):
    searching, tried = search._Search(worlds, QUICK, 3), []

    def replay(actions, level, generator, *, again=False):
        tried.append(level)
        return Waypoints(), shares[round(np.log2(QUICK.noise / level))]

    monkeypatch.setattr(searching, "_replay", replay)
    searching._keep(np.zeros((9, 3)), np.random.default_rng(0))
    assert searching.best.share == pytest.approx(kept)
    assert sorted(set(tried), reverse=True) == pytest.approx([QUICK.noise / 2**k for k in range(levels)])
    assert len(tried) == QUICK.replays * (levels + 8 * (kept > 0.0))  # further tries have the last one


def test_further_tries_begin_within_replays_that_failed(worlds):
    searching = search._Search(worlds, QUICK, 3)
    lift = np.zeros((9, 3))
    lift[:2, 2] = 1.0  # straight up, beside the cube, which stays where it is
    tries = searching._failed(lift, 0.0, np.random.default_rng(0))
    assert 5 < len(tries) < 16  # 0.7 of 16
    now = searching._replays.run.object_state
    for world, one in tries.items():
        np.testing.assert_allclose(one.object_state, now[world], atol=1e-3)
        np.testing.assert_allclose(one.X_WO.translation(), one.object_state[4:7], atol=1e-3)
        assert one.p_WP[2] > one.begun[2] + 0.1
        assert np.linalg.norm((one.p_WP - one.begun)[:2]) < 0.02  # the side of the cube where episodes begin
