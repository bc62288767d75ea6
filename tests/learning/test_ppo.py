# SPDX-License-Identifier: MIT
import csv
from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning import rounds
from pinwm_drake.learning.actor_critic import ActorCritic, Augmented, Ppo
from pinwm_drake.learning.actors import LEVELS, ImageActor, StateActor, chosen, level_shares
from pinwm_drake.learning.images.augment import Augment
from pinwm_drake.learning.policy import make_actor
from pinwm_drake.learning.ppo import MeanWeights, PpoOptions, train_ppo
from pinwm_drake.learning.rounds import StageRun
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from tests.learning.toy_worlds import ToyWorlds, toy_spec

SHORT = PpoOptions(steps=512, round_steps=128, n_steps=8, batch_size=32, n_epochs=2, episodes=4)


class Killed(Exception):
    pass


def weights(policy):
    return {name: value.numpy().copy() for name, value in policy.actor.state_dict().items()}


def same(a, b):
    return all(np.array_equal(a[name], b[name]) for name in a)


def test_the_mean_of_the_levels_next_to_an_action_is_that_action():
    action = torch.tensor([[-1.0, 1.0, 0.0], [0.2, -0.51, 1 / 3]])
    shares = level_shares(action)
    torch.testing.assert_close(shares.sum(-1), torch.ones(2, 3))
    torch.testing.assert_close(shares @ torch.tensor(LEVELS), action)
    assert ((shares > 1e-6).sum(-1) <= 2).all()


def test_it_learns_from_the_state(tmp_path):
    spec = toy_spec("state")
    options = PpoOptions(
        steps=3_000,
        round_steps=1_500,
        n_steps=32,
        batch_size=128,
        episodes=64,
    )
    policy = train_ppo(ToyWorlds(images=False), spec, options, StageRun(tmp_path, "teacher"))
    before = evaluate_worlds(ToyWorlds(images=False), untrained(spec), 64, seed=5)
    after = evaluate_worlds(ToyWorlds(images=False), policy, 64, seed=5)
    assert before.success_rate < 0.5
    assert after.success_rate > 0.9
    assert isinstance(policy.actor, StateActor)


def test_the_policy_has_the_mean_of_the_weights_that_acted():
    layer, seen = torch.nn.Linear(1, 1, bias=False), []
    mean = MeanWeights(lambda: layer, 0.75)
    for value in (1.0, 3.0, 5.0, 7.0, 9.0, -1.0):
        with torch.no_grad():
            layer.weight[:] = value
        mean._on_rollout_end()
        seen.append(float(mean.mean.module.weight.detach()))
    np.testing.assert_allclose(seen, [1.0, 2.0, 3.0, 4.0, 5.25, 3.6875], atol=1e-6)


@pytest.mark.nightly
def test_it_ends_when_episodes_get_no_shorter(tmp_path):
    options = PpoOptions(steps=80_000, round_steps=4_000, n_steps=32, batch_size=128, episodes=64, patience=1)
    train_ppo(ToyWorlds(images=False), toy_spec("state"), options, StageRun(tmp_path, "teacher"))
    with (tmp_path / rounds.HISTORY_FILE).open() as file:
        rows = list(csv.DictReader(file))
    lengths = [float(row["length"]) for row in rows]
    # A round has to be shorter by 5 % to count.
    enough = next(k for k, length in enumerate(lengths) if length <= 1.05 * min(lengths))
    assert float(rows[enough]["success"]) > 0.8
    assert len(rows) == enough + 2 < 20


def untrained(spec):
    from pinwm_drake.learning.policy import Policy

    torch.manual_seed(0)
    return Policy(spec, make_actor(spec))


@pytest.fixture
def often(monkeypatch):
    """Rounds are kept before every rollout and after every update."""
    monkeypatch.setattr(rounds, "_PERIOD", 0.0)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Of a learner, its policy after a training that nobody kills, and the rounds that it begins."""

    @cache
    def train(observes, auxiliary):
        begun, folder = [], tmp_path_factory.mktemp("whole")
        worlds, short = ToyWorlds(images=observes == "rgb"), replace(SHORT, auxiliary=auxiliary)
        return train_ppo(worlds, toy_spec(observes), short, StageRun(folder, "ppo", on_round=begun.append)), begun

    return train


# The first report is that of the beginning; then one for each of a round's two rollouts, and one for the round. A round
# is kept before its second rollout, so that after the sixth report, in the second round, its first one is not redone.
@pytest.mark.parametrize(
    ("observes", "auxiliary", "reports", "redone", "kept"),
    [
        pytest.param(*learner, *kill, marks=[pytest.mark.nightly] if "rgb" in learner and not kill[-1] else [])
        for learner in (("state", 0), ("rgb", 0), ("rgb", 1))
        for kill in ((4, 3, 0), (5, 3, 0), (6, 3, 1), (7, 2, 0))
    ],
)
@pytest.mark.usefixtures("often")
def test_a_training_that_was_killed_goes_on_with_the_same_result(
    tmp_path, whole, observes, auxiliary, reports, redone, kept
):
    spec, images, short = toy_spec(observes), observes == "rgb", replace(SHORT, auxiliary=auxiliary)
    policy, begun = whole(observes, auxiliary)
    told = []

    def kill(step):
        told.append(step)
        if len(told) == reports:
            raise Killed

    with pytest.raises(Killed):
        train_ppo(ToyWorlds(images=images), spec, short, StageRun(tmp_path / "b", "ppo", report=kill))
    again, told = [], []
    follow = {"on_round": again.append, "report": told.append}
    rest = train_ppo(ToyWorlds(images=images), spec, short, StageRun(tmp_path / "b", "ppo", resume=True, **follow))
    assert same(weights(policy), weights(rest))
    assert len(begun) == 4
    assert begun[-redone:] == again
    assert len(told) == 1 + 3 * redone - kept
    assert not (tmp_path / "b" / rounds.ROUND_FILE).exists()
    rows = list(csv.DictReader((tmp_path / "b" / "history.csv").read_text().splitlines()))
    assert [int(row["steps"]) for row in rows] == [128, 256, 384, 512]


@pytest.mark.usefixtures("often")
def test_time_before_a_training_was_killed_counts(tmp_path, monkeypatch):
    now = [0.0]  # s
    monkeypatch.setattr(rounds, "time", SimpleNamespace(monotonic=lambda: now[0]))
    told, again = [], []

    def kill(step):
        told.append(step)
        now[0] += 100.0
        if len(told) == 3:  # in the second rollout of the first round
            raise Killed

    train = partial(train_ppo, ToyWorlds(images=False), toy_spec("state"), SHORT)
    with pytest.raises(Killed):
        train(StageRun(tmp_path, "ppo", report=kill))
    train(StageRun(tmp_path, "ppo", resume=True, report=again.append))
    assert {step.seconds for step in again[1:]} == {200.0}  # as of the second rollout's beginning


def test_progress_tells_of_every_rollout(tmp_path):
    told = []
    train_ppo(ToyWorlds(images=False), toy_spec("state"), SHORT, StageRun(tmp_path, "ppo", report=told.append))
    assert [step.steps for step in told] == [0, 64, 128, 128, 192, 256, 256, 320, 384, 384, 448, 512, 512]
    assert [step.done for step in told] == [step.steps / 512 for step in told]
    assert np.isnan([told[0].success, *(value for step in told[:2] for value in (step.rate, step.left))]).all()
    assert all(step.rate > 0.0 and step.left >= 0.0 for step in told[2:])
    assert not np.isnan([(step.success, step.loss) for step in told[3:]]).any()


@pytest.mark.usefixtures("often")
def test_a_round_of_another_training_is_refused(tmp_path):
    def kill(step):
        if step.steps == 128:
            raise Killed

    with pytest.raises(Killed):
        train_ppo(ToyWorlds(images=False), toy_spec("state"), SHORT, StageRun(tmp_path, "ppo", report=kill))
    assert (tmp_path / rounds.ROUND_FILE).exists()
    with pytest.raises(InputError, match="seed = 0"):
        train_ppo(ToyWorlds(images=False), toy_spec("state"), SHORT, StageRun(tmp_path, "ppo", seed=1, resume=True))


def test_another_seed_gives_another_policy(tmp_path, whole):
    first, _ = whole("state", 0)
    second = train_ppo(ToyWorlds(images=False), toy_spec("state"), SHORT, StageRun(tmp_path, "ppo", seed=1))
    assert not same(weights(first), weights(second))


def test_a_checkpoint_of_other_settings_is_refused(tmp_path):
    spec, short = toy_spec("state"), replace(SHORT, steps=SHORT.round_steps)
    train_ppo(ToyWorlds(images=False), spec, short, StageRun(tmp_path, "teacher"))
    with pytest.raises(InputError, match="seed = 0"):
        train_ppo(ToyWorlds(images=False), spec, short, StageRun(tmp_path, "teacher", seed=1, resume=True))


def test_the_actor_sees_images_alone_and_the_critic_the_state():
    env, actor = ToyWorlds(images=True), ImageActor(toy_spec("rgb"))
    model = Ppo(ActorCritic, env, n_steps=4, policy_kwargs={"actor": actor}, device="cpu")
    env.seed(0)
    seen = {name: torch.from_numpy(values) for name, values in env.reset().items()}
    action, value, _ = model.policy(seen, deterministic=True)
    blind = seen | {"state": torch.zeros_like(seen["state"])}
    action_, value_, _ = model.policy(blind, deterministic=True)
    assert torch.equal(action, action_)
    assert not torch.allclose(value, value_)
    dark = seen | {"image": torch.zeros_like(seen["image"])}
    action_, value_, _ = model.policy(dark, deterministic=True)
    assert not torch.equal(action, action_)
    assert torch.equal(value, value_)


def test_the_actor_acts_as_sb3s_policy_does():
    env, actor = ToyWorlds(images=True), ImageActor(toy_spec("rgb"))
    model = Ppo(ActorCritic, env, n_steps=4, policy_kwargs={"actor": actor}, device="cpu")
    env.seed(0)
    observation = env.reset()
    actor = model.policy.pull().eval()
    seen = {name: torch.from_numpy(values) for name, values in observation.items()}
    with torch.no_grad():
        expected = torch.stack([one.logits for one in model.policy.get_distribution(seen).distribution], 1)
        assert torch.allclose(actor(seen["image"], seen["pusher"]), chosen(expected), atol=1e-6)


def test_what_is_learned_from_is_what_was_seen_when_an_action_was_taken():
    env, actor = Augmented(ToyWorlds(images=True), Augment(2, 0.5)), ImageActor(toy_spec("rgb"))
    policy = {"actor": actor}
    model = Ppo(ActorCritic, env, 1e-12, n_steps=8, batch_size=64, n_epochs=1, policy_kwargs=policy, device="cpu")
    with torch.no_grad():
        model.policy.action_net.weight.mul_(1000.0)
    model.learn(64, log_interval=1000)
    assert abs(model.logger.name_to_value["train/approx_kl"]) < 1e-9


def test_a_training_from_images_changes_them(tmp_path):
    short = replace(SHORT, steps=SHORT.round_steps, episodes=1)
    plain, changed = (
        train_ppo(
            ToyWorlds(images=True), toy_spec("rgb"), replace(short, gain=gain), StageRun(tmp_path / str(gain), "ppo")
        )
        for gain in (0.0, 0.5)
    )
    # As many random numbers are drawn in both, so that the images alone make the difference.
    assert not same(weights(plain), weights(changed))


@pytest.mark.parametrize(
    "values", [{"steps": 0}, {"gamma": float("nan")}, {"shift": -1}, {"learning_rate": -1.0}, {"auxiliary": -1}]
)
def test_options_that_make_no_sense_are_refused(values):
    with pytest.raises(ParameterError, match=next(iter(values))):
        PpoOptions(**values)


def test_a_history_beside_images_is_refused(tmp_path):
    with pytest.raises(ParameterError, match="history: got 1 for PPO from images"):
        train_ppo(ToyWorlds(images=True), toy_spec("rgb", history=1), PpoOptions(), StageRun(tmp_path, "ppo"))
