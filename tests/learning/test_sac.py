# SPDX-License-Identifier: MIT
import csv
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning import rounds, sac
from pinwm_drake.learning.actors import DitherActor
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.rounds import StageRun
from pinwm_drake.learning.sac import SacOptions, train_sac
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from tests.learning.toy_worlds import ToyWorlds, toy_spec

# A hundred steps are kept, so that the third round overwrites what the first one left.
SHORT = SacOptions(
    steps=192, round_steps=64, learning_starts=24, update_every=4, batch_size=16, buffer_size=104, episodes=8
)
SPEC = toy_spec("state", head="dither")


class Killed(Exception):
    pass


def weights(policy):
    return {name: value.numpy().copy() for name, value in policy.actor.state_dict().items()}


def _history(folder):
    return list(csv.DictReader((folder / "history.csv").read_text().splitlines()))


def same(a, b):
    return all(np.array_equal(a[name], b[name]) for name in a)


@pytest.mark.nightly
def test_it_learns_from_the_state_and_ends_when_rounds_bring_no_more(tmp_path):
    options = SacOptions(
        steps=24_000,
        round_steps=1_200,
        learning_starts=400,
        update_every=2,
        batch_size=128,
        episodes=64,
        patience=1,
    )
    policy = train_sac(ToyWorlds(images=False), SPEC, options, StageRun(tmp_path, "teacher"))
    torch.manual_seed(0)
    before = evaluate_worlds(ToyWorlds(images=False), Policy(SPEC, make_actor(SPEC)), 64, seed=5)
    after = evaluate_worlds(ToyWorlds(images=False), policy, 64, seed=5)
    assert before.success_rate < 0.5
    assert after.success_rate > 0.9
    assert isinstance(policy.actor, DitherActor)
    lengths = [float(row["length"]) for row in _history(tmp_path)]
    assert len(lengths) == lengths.index(min(lengths)) + 2 < 20


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Policy of a training that nobody kills, the rounds that it begins, and its folder."""
    folder, begun = tmp_path_factory.mktemp("whole"), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rounds, "_PERIOD", 0.0)
        patch.setattr(sac, "_TOLD", 1)
        policy = train_sac(ToyWorlds(images=False), SPEC, SHORT, StageRun(folder, "sac", on_round=begun.append))
    return policy, begun, folder


# Eight actions of all worlds a round, the first three random. Reports: the beginning, one an action, the round's end.
@pytest.mark.parametrize(("reports", "redone", "kept"), [(3, 3, 1), (6, 3, 4), (12, 2, 1), (26, 1, 6)])
def test_a_training_that_was_killed_goes_on_with_the_same_result(tmp_path, monkeypatch, whole, reports, redone, kept):
    monkeypatch.setattr(rounds, "_PERIOD", 0.0)
    monkeypatch.setattr(sac, "_TOLD", 1)
    (policy, begun, folder), again, told = whole, [], []

    def kill(step):
        told.append(step)
        if len(told) == reports:
            raise Killed

    with pytest.raises(Killed):
        train_sac(ToyWorlds(images=False), SPEC, SHORT, StageRun(tmp_path / "b", "sac", report=kill))
    told = []
    follow = {"on_round": again.append, "report": told.append}
    rest = train_sac(ToyWorlds(images=False), SPEC, SHORT, StageRun(tmp_path / "b", "sac", resume=True, **follow))
    assert same(weights(policy), weights(rest))
    assert begun[-redone:] == again
    assert len(told) == 1 + 9 * redone - kept
    rows = _history(tmp_path / "b")
    assert [int(row["steps"]) for row in rows] == [64, 128, 192]
    both = [np.load(run / "checkpoint.npz") for run in (folder, tmp_path / "b")]
    names = [name for name in both[0].files if name not in ("about", "history")]
    assert {name.split("/")[0] for name in names if not name.startswith("best.")} == {
        "actor",
        "critic",
        "target",
        "entropy",
    }
    assert all(np.array_equal(both[0][name], both[1][name]) for name in names)


def test_the_policy_acts_within_sb3s_distribution(tmp_path):
    env = ToyWorlds(images=False)
    learner = sac._Learner(env, SPEC, SHORT, StageRun(tmp_path, "sac"))
    model = learner.model
    env.seed(0)
    seen = torch.from_numpy(env.reset())
    with torch.no_grad():
        model.actor.mu.weight.mul_(10.0)
        mean, log_std, _ = model.actor.get_action_dist_params(seen)
    policy = Policy(SPEC, learner.network())
    off = (np.arctanh(policy.predict(seen.numpy())[0]) - mean.numpy()) / log_std.exp().numpy()
    assert np.abs(off).max() <= np.sqrt(2.0) + 1e-3
    assert np.abs(off).max() > 1.0
    np.testing.assert_allclose(policy.actor._parts(seen)[0].detach(), mean, atol=1e-5)
    assert np.abs(mean.numpy()).max() > 0.5


def test_it_goes_on_while_nothing_succeeds(tmp_path):
    options = replace(SHORT, steps=256, patience=1, learning_rate=1e-12)
    train_sac(ToyWorlds(images=False), SPEC, options, StageRun(tmp_path, "sac"))
    successes = [float(row["success"]) for row in _history(tmp_path)]
    assert len(successes) == 4
    assert max(successes) < 0.5


def test_it_ends_with_the_first_round_that_reaches_the_target(tmp_path):
    options = SacOptions(
        steps=24_000, round_steps=400, learning_starts=100, update_every=2, batch_size=128, episodes=64, patience=20
    )
    until = rounds.Until(target=0.9)
    policy = train_sac(ToyWorlds(images=False), SPEC, options, StageRun(tmp_path, "sac", until=until))
    *before, last = [float(row["success"]) for row in _history(tmp_path)]
    assert last >= 0.9 > max(before, default=0.0)
    assert evaluate_worlds(ToyWorlds(images=False), policy, 64, seed=5).success_rate > 0.5


def test_it_ends_before_it_takes_longer_than_it_may(tmp_path):
    train_sac(ToyWorlds(images=False), SPEC, SHORT, StageRun(tmp_path, "sac", until=rounds.Until(minutes=1e-6)))
    assert len(_history(tmp_path)) == 1
    train_sac(ToyWorlds(images=False), SPEC, SHORT, StageRun(tmp_path, "sac", resume=True))  # with all its time
    assert len(_history(tmp_path)) == 3
    assert rounds.minutes_of(tmp_path) > 0.0 == rounds.minutes_of(tmp_path / "nothing")


@pytest.mark.parametrize("values", [{"target": 0.0}, {"target": 1.5}, {"minutes": 0.0}, {"minutes": float("nan")}])
def test_ends_that_make_no_sense_are_refused(values):
    with pytest.raises(ParameterError, match=next(iter(values))):
        rounds.Until(**values)


def test_steps_that_are_missing_are_named(tmp_path):
    train_sac(ToyWorlds(images=False), SPEC, SHORT, StageRun(tmp_path, "sac", until=rounds.Until(minutes=1e-6)))
    (tmp_path / "replay" / "0000.npz").unlink()
    with pytest.raises(InputError, match=r"0000\.npz"):
        train_sac(ToyWorlds(images=False), SPEC, SHORT, StageRun(tmp_path, "sac", resume=True))


def test_steps_of_a_training_that_is_over_are_not_needed(tmp_path):
    whole = train_sac(ToyWorlds(images=False), SPEC, SHORT, StageRun(tmp_path, "sac"))
    shutil.rmtree(tmp_path / "replay")
    again = train_sac(ToyWorlds(images=False), SPEC, SHORT, StageRun(tmp_path, "sac", resume=True))
    left, right = weights(whole), weights(again)
    assert all(np.array_equal(left[name], right[name]) for name in left)


@pytest.mark.parametrize("spec", [toy_spec("rgb", head="dither"), toy_spec("state")])
def test_a_policy_of_another_kind_is_refused(tmp_path, spec):
    with pytest.raises(ParameterError, match="allowed: state and dither"):
        train_sac(ToyWorlds(images=False), spec, SHORT, StageRun(tmp_path, "sac"))


@pytest.mark.parametrize("values", [{"steps": 0}, {"gamma": float("nan")}, {"tau": -1.0}, {"update_every": 0}])
def test_options_that_make_no_sense_are_refused(values):
    with pytest.raises(ParameterError, match=next(iter(values))):
        SacOptions(**values)
