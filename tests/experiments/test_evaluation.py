# SPDX-License-Identifier: MIT
import csv
import dataclasses
import os
import signal
from multiprocessing import active_children

import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError, ParameterError, SolverError
from pinwm_drake.experiments.evaluation.contestant import read_contestant
from pinwm_drake.experiments.evaluation.episodes import EpisodeRunner, _run, run_episodes
from pinwm_drake.experiments.evaluation.results import settings_of
from pinwm_drake.experiments.evaluation.run import REPORT_FILE, TABLE_FILE, VIDEO_FILE, evaluate
from pinwm_drake.experiments.evaluation.store import EpisodeStore
from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
from pinwm_drake.learning.policy import Policy, make_actor, write_policy
from pinwm_drake.parallel import Executor
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.policy_scene import policy_spec
from tests.cli.evaluations import document, write_scenario
from tests.systems.stations import action_setup


@pytest.fixture(scope="module")
def scenario(tmp_path_factory) -> str:
    return write_scenario(tmp_path_factory.mktemp("scenario"))


def test_an_evaluation_is_a_call_that_prints_nothing(scenario, tmp_path, capsys):
    told = []
    request = EvaluateRequest("random", scenario, "twin", episodes=2, seed=5, max_steps=4)
    found = evaluate(request, tmp_path, workers=1, progress=told.append)
    assert capsys.readouterr() == ("", "")
    assert [(one.done, one.total) for one in told if one.drawn is None] == [(0, 2), (1, 2), (2, 2)]
    assert told[0].evaluation is None
    assert told[-1].drawn == 1.0
    assert told[-1].evaluation == found
    assert [episode.seed for episode in found.results] == [5, 6]
    assert document(tmp_path)["results"] == found.summary()
    with (tmp_path / TABLE_FILE).open() as file:
        assert [int(row["seed"]) for row in csv.DictReader(file)] == [5, 6]
    assert (tmp_path / VIDEO_FILE).exists()
    assert (tmp_path / REPORT_FILE).exists()


def test_an_episode_whose_physics_fails_is_kept(scenario, tmp_path, monkeypatch):
    request = EvaluateRequest("random", scenario, "twin", episodes=1, max_steps=9)
    runner = EpisodeRunner(read_contestant(request), request)
    advance, calls = runner.env.run.advance, []

    def fails(action):
        calls.append(action)
        if len(calls) == 3:
            raise SolverError("no solution")
        advance(action)

    monkeypatch.setattr(runner.env.run, "advance", fails)
    record = runner.run(4)
    assert (record.result.outcome, record.result.failure, record.result.steps) == ("failure", "no solution", 3)
    assert record.p_WO.shape == (4, 3)
    assert 0.0 <= record.result.coverage < 1.0
    store = EpisodeStore(tmp_path, {"a": 1}, resume=False)
    store.write(4, record)
    assert (store.read(3), store.read(5)) == (None, None)
    kept = store.read(4)
    assert kept.result == record.result
    for name in ("q_WO", "p_WO", "p_WP", "views", "at", "seconds", "cpu_seconds"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(record, name))


@pytest.mark.nightly
def test_a_worker_that_is_killed_is_told_of(scenario, tmp_path):
    request = EvaluateRequest("random", scenario, "twin", episodes=200, max_steps=20)
    runner, store = EpisodeRunner(read_contestant(request), request), EpisodeStore(tmp_path, {}, resume=False)
    before, seen = set(active_children()), []

    def kill(seed, record):
        if not seen:
            (first, *_) = set(active_children()) - before
            os.kill(first.pid, signal.SIGKILL)
        seen.append(seed)

    with pytest.raises(ParameterError, match=r"--workers: one of 2 processes ended by itself.*--resume"):
        run_episodes(runner, request, request.seeds, store, Executor(workers=2), on_result=kill)
    assert all(store.read(seed) is not None for seed in seen)
    assert 1 <= len(seen) < 200


def test_a_policy_that_changes_meanwhile_is_told_of(scenario):
    with pytest.raises(ParameterError, match="the policy changed while it was evaluated"):
        _run(EvaluateRequest("random", scenario, "twin"), "something else", 0)


def test_an_evaluation_may_be_late(scenario):
    paths = []
    for latency in (0.0, 0.1):
        request = EvaluateRequest("random", scenario, "twin", episodes=1, max_steps=9, latency=latency)
        paths.append(EpisodeRunner(read_contestant(request), request).run(4).p_WP)
    np.testing.assert_allclose(paths[1][1:], paths[0][:-1], atol=1e-9)
    with pytest.raises(ParameterError, match="--latency"):
        EvaluateRequest("random", scenario, "twin", latency=-0.1)


def test_a_policy_has_the_pusher_and_the_delay_that_it_was_trained_with(scenario, tmp_path):
    at_once = policy_spec(action_setup(scenario), EnvOptions(frames=2, max_translation=0.02, max_steps=2), "rgb")
    # Either 0 s was among the delays of its training, or a policy has never seen it.
    cases = {"often": (0.0, 0.12), "always": (0.09, 0.18)}
    found = {}
    for name, latency in cases.items():
        spec = dataclasses.replace(at_once, latency=latency, acceleration=7.0)
        write_policy(tmp_path / name, Policy(spec, make_actor(spec), {}))
        for given in (None, 0.05):
            request = EvaluateRequest(str(tmp_path / name), scenario, "twin", episodes=1, latency=given)
            runner = EpisodeRunner(read_contestant(request), request)
            assert runner.env.worlds.acceleration == 7.0
            settings = settings_of(request, runner.contestant, runner.env, "")
            found[name, given] = settings["latency"]
            assert settings["acceleration"] == 7.0
            assert "lag" not in settings
    assert found == {
        ("often", None): 0.0,
        ("often", 0.05): 0.05,
        ("always", None): [0.09, 0.18],
        ("always", 0.05): 0.05,
    }


def test_a_lag_that_a_policy_never_was_without_is_there_and_told(scenario, tmp_path):
    at_once = policy_spec(action_setup(scenario), EnvOptions(frames=2, max_translation=0.02, max_steps=2), "rgb")
    told = []
    for name, lag in (("often", (0.0, 0.05)), ("always", (0.02, 0.05))):
        spec = dataclasses.replace(at_once, lag=lag)
        write_policy(tmp_path / name, Policy(spec, make_actor(spec), {}))
        request = EvaluateRequest(str(tmp_path / name), scenario, "twin", episodes=1)
        runner = EpisodeRunner(read_contestant(request), request)
        told.append(settings_of(request, runner.contestant, runner.env, "").get("lag"))
    assert told == [None, [0.02, 0.05]]


def test_a_stand_in_is_another_scene_that_policies_do_not_know(scenario, tmp_path):
    torch.manual_seed(0)
    spec = policy_spec(action_setup(scenario), EnvOptions(frames=2, max_translation=0.02, max_steps=2), "rgb")
    write_policy(tmp_path / "policy", Policy(spec, make_actor(spec), {}))
    found = []
    for stand_in in (False, True, True):
        request = EvaluateRequest(str(tmp_path / "policy"), scenario, "point", episodes=1, stand_in=stand_in)
        found.append(EpisodeRunner(read_contestant(request), request))
    plain, _, again = found
    first, second, third = (one.run(3) for one in found)
    for name in ("p_WO", "q_WO", "p_WP", "views"):
        np.testing.assert_array_equal(getattr(second, name), getattr(third, name))
    # The same start; 80 of the first 100 ms pass before anything moves.
    np.testing.assert_allclose(second.p_WP[0], first.p_WP[0], atol=1e-4)
    moved = [np.linalg.norm(record.p_WP[1] - record.p_WP[0]) for record in (first, second)]
    assert moved[1] == pytest.approx(0.2 * moved[0], rel=0.3)
    # The object is seen, in another light and outline.
    shown = [(record.views[0] < 255).any(axis=-1) for record in (first, second)]
    assert 0 < (shown[0] != shown[1]).sum() < 0.6 * shown[0].sum()
    both = shown[0] & shown[1]
    assert np.abs(first.views[0][both].astype(int) - second.views[0][both]).mean() > 10
    settings = settings_of(request, again.contestant, again.env, "")
    assert "stand_in" not in settings_of(dataclasses.replace(request, stand_in=False), plain.contestant, plain.env, "")
    assert settings["stand_in"]["camera_place"] == 0.003
    assert settings["latency"] == settings["stand_in"]["latency"] == 0.08
    EpisodeStore(tmp_path / "store", {"a": 1}, resume=False).write(3, second)
    with pytest.raises(InputError, match="stand_in"):
        EpisodeStore(tmp_path / "store", {"a": 1, "stand_in": {}}, resume=True).read(3)


def test_a_stand_in_is_a_plant_with_a_latency_of_its_own():
    with pytest.raises(ParameterError, match="--stand-in: got one with engine twin"):
        EvaluateRequest("random", engine="twin", stand_in=True)
    with pytest.raises(ParameterError, match="--latency"):
        EvaluateRequest("random", latency=0.1, stand_in=True)
