# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
import yaml

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning.actors import LEVELS, chosen
from pinwm_drake.learning.policy import Policy, make_actor, read_policy, weights_digest, write_policy
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.tasks.push import PushTask
from tests.learning.bundles import image_spec, untrained_policy
from tests.learning.toy_worlds import ToyWorlds, toy_spec


@pytest.fixture
def policy():
    torch.manual_seed(0)
    spec = toy_spec("rgb")
    return Policy(spec, make_actor(spec), {"seed": 3})


def test_a_policy_is_read_as_it_was_written(tmp_path, policy):
    write_policy(tmp_path, policy)
    again = read_policy(tmp_path)
    assert again.spec == policy.spec
    assert again.provenance == {"seed": 3}
    assert weights_digest(again) == weights_digest(policy)
    env = ToyWorlds()
    env.seed(0)
    seen = env.reset()
    actions = policy.predict(seen)[0]
    assert np.array_equal(actions, again.predict(seen)[0])
    one = {name: values[3] for name, values in seen.items()}
    assert np.allclose(again.predict(one)[0], actions[3], atol=1e-6)
    assert again.predict(one)[0].shape == (2,)


def test_the_likeliest_level_is_taken_and_its_neighbours_are_heard():
    logits = torch.full((4, 2, len(LEVELS)), -50.0)
    logits[0, 0, 0] = logits[0, 1, -1] = 0.0
    logits[1, 0, 9] = logits[1, 0, 10] = 0.0  # between two
    logits[1, 1, 0], logits[1, 1, -1] = 0.1, 0.0  # two ways: one of them, and not their mean
    logits[2] = 0.0
    logits[2, :, 1] = 1e-6
    logits[3, 0, 1] = torch.nan
    actions = chosen(logits)
    assert actions[:3].numpy() == pytest.approx(np.array([[-1.0, 1.0], [1 / 18, -1.0], [-8 / 9, -8 / 9]]), abs=1e-6)
    assert actions[3].isnan().tolist() == [True, False]


def test_the_pusher_stands_in_the_state_of_images_where_it_does_in_that_of_worlds():
    spec = toy_spec("rgb", task=PushTask(goal=(0.05, -0.1, 0.7)))
    actor = make_actor(spec)
    pusher = torch.tensor([[-1.0, 1.0], [0.2, -0.4], [0.0, 0.0]])
    state = actor.state(255 * torch.rand(3, 16, 16, 6), pusher).detach().numpy()
    x, y, c, s = state[:, :4].T
    assert np.hypot(c, s) == pytest.approx(1.0, abs=1e-6)
    # From the box's corners to the world, from there to the goal's axes, by hand.
    p_WP = np.array([0.0, 0.1]) + np.array([0.3, 0.3]) * [[-1.0, 1.0], [0.2, -0.4], [0.0, 0.0]]
    turned = np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]])
    p = (p_WP - [0.05, -0.1]) @ turned.T / 0.1
    assert state[:, 9:] == pytest.approx(p, abs=1e-5)
    away = p - np.stack([x, y], 1)
    from_object = np.stack([c * away[:, 0] + s * away[:, 1], -s * away[:, 0] + c * away[:, 1]], 1)
    assert state[:, 7:9] == pytest.approx(from_object, abs=1e-5)


def test_an_observation_without_what_a_policy_sees_is_refused(policy):
    with pytest.raises(ParameterError, match=r"observation: got \['pusher'\]; allowed: a dict with image and pusher"):
        policy.predict({"pusher": np.zeros(2, np.float32)})
    with pytest.raises(ParameterError, match="observation: got ndarray"):
        policy.predict(np.zeros(11, np.float32))
    spec = toy_spec("state")
    with pytest.raises(ParameterError, match=r"\['image'\]; allowed: a dict with state"):
        Policy(spec, make_actor(spec)).predict({"image": 0})


def test_a_policy_of_the_state_takes_the_state_alone_or_among_others():
    spec = toy_spec("state")
    policy = Policy(spec, make_actor(spec))
    state = np.random.default_rng(0).normal(size=(5, 11)).astype(np.float32)
    assert np.array_equal(policy.predict(state)[0], policy.predict({"state": state})[0])
    assert policy.predict(state[0])[0].shape == (2,)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(schema_version=3), "schema_version"),
        (lambda d: d["spec"].update(frames=0), "frames"),
        (lambda d: d["spec"].update(colour=1), "colour"),
        (lambda d: d["spec"].update(horizon=float("nan")), "horizon"),
        (lambda d: d["spec"]["task"].update(goal=[0.0, 1.0]), "task.goal"),
        (lambda d: d["spec"]["task"].update(name="juggle"), "juggle"),
        (lambda d: d["spec"].update(frames=1), "weights"),
        (lambda d: d.update(provenance={"loss": float("nan")}), "got NaN or an infinite number; allowed: finite"),
    ],
)
def test_a_document_that_was_changed_is_refused(tmp_path, policy, change, message):
    write_policy(tmp_path, policy)
    path = tmp_path / "policy.yaml"
    document = yaml.safe_load(path.read_text())
    change(document)
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(InputError, match=message):
        read_policy(tmp_path)


def test_images_that_are_smaller_than_the_first_layers_kernel_are_refused(tmp_path):
    write_policy(tmp_path, untrained_policy(image_spec(16, 1)))
    path = tmp_path / "policy.yaml"
    path.write_text(path.read_text().replace("height: 16", "height: 1"))
    with pytest.raises(InputError, match="camera or window: got 16 x 1 px; allowed: 4 px a side or more"):
        read_policy(tmp_path)


def test_files_that_are_missing_or_broken_are_named(tmp_path, policy):
    with pytest.raises(InputError, match=r"policy\.yaml"):
        read_policy(tmp_path)
    write_policy(tmp_path, policy)
    whole = (tmp_path / "weights.npz").read_bytes()
    (tmp_path / "weights.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"weights\.npz"):
        read_policy(tmp_path)
    (tmp_path / "weights.npz").unlink()
    with pytest.raises(InputError, match=r"weights\.npz"):
        read_policy(tmp_path)


@pytest.mark.parametrize("history", [0, 1])
def test_a_specification_survives_its_document(history):
    spec = toy_spec("rgb", history=history)
    assert PolicySpec.from_document(yaml.safe_load(yaml.safe_dump(spec.to_document()))) == spec
    assert ("history" in spec.to_document()) == bool(history)  # documents without one are as they were


@pytest.mark.parametrize(
    "changes",
    [
        {"observes": "smell"},
        {"horizon": 0.0},
        {"pusher_low": (1.0, 1.0)},
        {"frames": 0},
        {"history": 2},
        {"history": -1, "observes": "state"},
        {"history": 1.0, "observes": "state"},
    ],
)
def test_a_specification_that_makes_no_sense_is_refused(changes):
    with pytest.raises(ParameterError):
        toy_spec(**changes)
