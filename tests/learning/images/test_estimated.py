# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.actor_critic import ActorCritic, Ppo
from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.learning.images.augment import Augment
from pinwm_drake.learning.images.estimated import (
    TRUTH,
    Estimated,
    Regression,
    estimation_loss,
    shown_components,
    usual_errors,
)
from pinwm_drake.learning.ppo import PpoOptions, train_ppo
from pinwm_drake.learning.rounds import StageRun
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from pinwm_drake.tasks.flip import FlipTask
from pinwm_drake.tasks.push import PushTask
from tests.learning.toy_worlds import ToyWorlds, toy_spec

N_STEPS = 8


def wrapped(actor=None):
    torch.manual_seed(0)
    actor = actor or ImageActor(toy_spec("rgb"))
    worlds = Estimated(ToyWorlds(images=True), actor, N_STEPS)
    worlds.seed(0)
    return worlds, actor


def test_the_policy_sees_what_the_network_finds_in_images_and_the_critic_the_truth():
    worlds, actor = wrapped()
    plain = ToyWorlds(images=True)
    plain.seed(0)
    seen, image = worlds.reset(), plain.reset()
    with torch.no_grad():
        expected = actor.state(torch.from_numpy(image["image"]), torch.from_numpy(image["pusher"]))
    np.testing.assert_array_equal(seen["state"], expected.numpy())
    np.testing.assert_array_equal(seen[TRUTH], image["state"])
    model = Ppo(ActorCritic, worlds, n_steps=N_STEPS, policy_kwargs={"actor": actor.actor}, device="cpu")
    given = {name: torch.from_numpy(values) for name, values in seen.items()}
    action, value, _ = model.policy(given, deterministic=True)
    other = {name: values + 0.5 for name, values in given.items()}
    action_, value_, _ = model.policy(given | {"state": other["state"]}, deterministic=True)
    assert not torch.equal(action, action_)
    assert torch.equal(value, value_)
    action_, value_, _ = model.policy(given | {TRUTH: other[TRUTH]}, deterministic=True)
    assert torch.equal(action, action_)
    assert not torch.allclose(value, value_)


def test_the_last_observation_of_an_episode_is_an_estimate_too():
    worlds, _ = wrapped()
    worlds.reset()
    last = []
    for _ in range(25):
        _, _, ended, infos = worlds.step(np.zeros((worlds.num_envs, 2), np.float32))
        last += [info["terminal_observation"] for info in infos if "terminal_observation" in info]
        assert all(("terminal_observation" in info) == end for info, end in zip(infos, ended, strict=True))
    assert last
    assert all(one["state"].shape == one[TRUTH].shape == (11,) for one in last)
    assert not np.allclose([one["state"][:2] for one in last], [one[TRUTH][:2] for one in last], atol=1e-3)


def test_as_much_is_kept_as_a_rollout_has_seen_and_its_pairs_belong_together():
    worlds, _ = wrapped()
    worlds.reset()
    for step in range(2 * N_STEPS + 3):
        action = np.full((worlds.num_envs, 2), 0.3 * (-1) ** step, np.float32)
        worlds.step(action)
    kept = worlds.kept()
    image, pusher, state = (kept[name] for name in ("image", "pusher", "state"))
    assert image.shape == (N_STEPS * worlds.num_envs, 16, 16, 6)
    assert pusher.shape == (len(image), 2)
    assert state.shape == (len(image), 11)
    # The square is drawn where the state says.
    corner = ((state[:, :2] + 1.0) / 2.0 * 12.0).round().long()
    newest = image[:, :, :, 4]  # green: 30 in the square
    found = torch.stack([(newest == 30).any(1).long().argmax(1), (newest == 30).any(2).long().argmax(1)], 1)
    assert torch.equal(found, corner)


def test_the_network_learns_from_rollouts_and_ppo_leaves_it_alone():
    worlds, actor = wrapped()
    model = Ppo(ActorCritic, worlds, n_steps=N_STEPS, batch_size=64, policy_kwargs={"actor": actor.actor}, device="cpu")
    before = {name: value.clone() for name, value in actor.state_dict().items() if not name.startswith("actor.")}
    model.learn(64, log_interval=1000)
    assert all(torch.equal(value, actor.state_dict()[name]) for name, value in before.items())
    optimizer = torch.optim.Adam(actor.estimation(), 1e-3)
    regression = Regression(worlds, actor, optimizer, Augment(0, 0.0), epochs=3, batch_size=32)
    acts = {name: value.clone() for name, value in actor.actor.state_dict().items()}
    regression.init_callback(model)

    def loss():
        kept = worlds.kept()
        with torch.no_grad():
            return float(estimation_loss(actor.state(kept["image"], kept["pusher"]), kept["state"]))

    first = loss()
    for _ in range(10):
        regression.on_rollout_end()
    assert loss() < 0.85 * first  # the rest of the loss is of a state that these worlds do not keep to
    assert all(torch.equal(value, actor.actor.state_dict()[name]) for name, value in acts.items())


@pytest.mark.nightly
def test_a_policy_of_images_is_learned_on_estimates(tmp_path):
    spec = toy_spec("rgb")
    options = PpoOptions(
        steps=16_000, round_steps=4_000, n_steps=32, batch_size=128, episodes=64, auxiliary=2, shift=0, gain=0.1
    )
    policy = train_ppo(ToyWorlds(images=True), spec, options, StageRun(tmp_path, "ppo"))
    assert evaluate_worlds(ToyWorlds(images=True), policy, 64, seed=5).success_rate > 0.9
    assert isinstance(policy.actor, ImageActor)


def test_errors_count_by_their_usual_size(monkeypatch):
    task = FlipTask()
    errors = usual_errors(task, 1, torch.device("cpu"))
    usual = torch.from_numpy(np.concatenate([task.errors, task.errors, np.zeros(3)])).float()
    state = torch.rand(4, 39)
    # Each of 36 components counts 1; ten usual errors count by their size: 2 (3 x 10 - 9 / 2).
    assert estimation_loss(state + usual, state, errors).item() == pytest.approx(36 / 39, rel=1e-4)
    assert estimation_loss(state + 10.0 * usual, state, errors).item() == pytest.approx(51.0 * 36 / 39, rel=1e-4)
    assert usual_errors(PushTask(), 0, torch.device("cpu")) is None
    for wrong in (task.errors[1:], (0.0, *task.errors[1:])):
        monkeypatch.setattr(FlipTask, "errors", wrong)
        with pytest.raises(ParameterError, match=r"task\.errors: got .*; allowed: 18 numbers, more than 0"):
            usual_errors(task, 1, torch.device("cpu"))


def test_states_whose_image_shows_nothing_do_not_count():
    task = FlipTask()
    images = torch.full((3, 20, 20, 9), 255, dtype=torch.uint8)
    images[1, :5, :5, 7] = 254  # 25 of 400 pixels of the last image
    images[2, :5, :3, 3] = 0  # 15 of the one before
    images[2, :, :, :3] = 0  # the first one, of which no state is told
    shown = shown_components(images, task, 1)
    assert shown.shape == (3, 39)
    assert shown[1].tolist() == [1.0] * 18 + [0.0] * 21
    assert not shown[[0, 2]].any()
    images[2, :5, :5, 4] = 0
    assert shown_components(images, task, 1)[2].tolist() == [0.0] * 18 + [1.0] * 21
    assert shown_components(images, task, 2)[2].tolist() == [0.0] * 18 + [1.0] * 42
    state = torch.zeros(3, 39)
    errors = usual_errors(task, 1, torch.device("cpu"))
    assert estimation_loss(state + 0.3, state, errors, shown[:1]).item() == 0.0
