# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
import yaml

from benchmarks.way_around.worlds import AroundWorlds, MakeAround
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning.policy import WEIGHTS_FILE
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from pinwm_drake.paper.baselines.diffusion.actor import (
    ACTOR_FILE,
    DiffusionActor,
    read_actor,
    write_actor,
)
from pinwm_drake.paper.baselines.diffusion.network import DiffusionNetwork
from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions

pytest.importorskip("diffusers")

SMALL = NetworkOptions(
    widths=(16, 24), channels=(8,), keypoints=4, image_features=8, step_features=16, sampling_steps=2, actions=3
)


def small_actor(seed=0):
    torch.manual_seed(0)
    return DiffusionActor(MakeAround().spec("rgb"), DiffusionNetwork(SMALL, 2).eval(), seed)


class Counting(DiffusionNetwork):
    """Actions that tell their number in the sequence, and the calls that drew them."""

    def __init__(self):
        super().__init__(SMALL, 2)
        self.drawn = []

    def sample(self, dark, pusher, noise):
        self.drawn.append((pusher.numpy().copy(), dark.numpy().copy()))
        numbers = torch.arange(SMALL.horizon) / 100.0 + len(self.drawn) / 10.0
        return numbers[None, :, None].expand(noise.shape).clone()


def seen(*values):
    image = np.stack([np.full((8, 8, 3), value, np.uint8) for value in values])
    return {"image": image, "pusher": np.array([[value / 100.0, 0.0] for value in values], np.float32)}


def test_each_world_carries_out_its_own_actions_from_the_start_of_its_episode():
    network = Counting()
    actor = DiffusionActor(MakeAround().spec("rgb"), network)
    told, state = [], None
    ends = [[True, True], [False, False], [False, True], [False, False], [False, False], [False, False]]
    for k, begins in enumerate(ends):
        actions, state = actor.predict(seen(2 * k, 2 * k + 1), state, np.array(begins))
        told.append(actions[:, 0])
    # World 0 draws at its actions 0 and 3; world 1 too, but it begins again at the third. The first action of a
    # sequence is that of the older observation, so that the second one is carried out first.
    wanted = [[0.11, 0.11], [0.12, 0.12], [0.13, 0.21], [0.31, 0.22], [0.32, 0.23], [0.33, 0.41]]
    assert np.allclose(told, wanted, atol=1e-6)
    shown = [np.round(100 * pusher[..., 0]).astype(int).tolist() for pusher, _ in network.drawn]
    assert shown == [[[0, 0], [1, 1]], [[5, 5]], [[4, 6]], [[9, 11]]]
    assert np.allclose(network.drawn[2][1][0, [0, 3], 0, 0], 1.0 - np.array([4, 6]) / 255.0)  # the older image first


def test_a_single_world_acts_as_one_of_many():
    actor = small_actor()
    many, _ = actor.predict(seen(10, 20, 30))
    one, state = actor.predict({name: values[1] for name, values in seen(10, 20, 30).items()})
    assert one.shape == (2,)
    # The noise follows from what is seen; sums over a batch are in another order.
    assert np.allclose(one, many[1], atol=1e-5)
    assert state.step.tolist() == [1]


def test_the_last_image_of_a_stack_is_seen():
    observation = seen(10)
    stacked = observation | {"image": np.concatenate([seen(77)["image"], observation["image"]], axis=3)}
    assert np.array_equal(small_actor().predict(observation)[0], small_actor().predict(stacked)[0])


def test_runs_repeat_and_seeds_tell_them_apart():
    found = [evaluate_worlds(AroundWorlds(4), small_actor(seed), 4, seed=1).steps() for seed in (0, 0)]
    assert np.array_equal(*found)
    first, second = (small_actor(seed).predict(seen(10))[0] for seed in (0, 1))
    assert not np.allclose(first, second)
    # Where nothing seems to change, other actions are tried.
    actor, state, drawn = small_actor(), None, []
    for _ in range(4):
        action, state = actor.predict(seen(10), state)
        drawn.append(action)
    assert not np.allclose(drawn[0], drawn[3])


def test_a_state_of_other_worlds_is_refused():
    actor = small_actor()
    _, state = actor.predict(seen(10, 20))
    with pytest.raises(ParameterError, match="state"):
        actor.predict(seen(10), state)
    with pytest.raises(ParameterError, match="image and pusher"):
        actor.predict({"state": np.zeros(4)})


def test_a_policy_that_was_read_acts_as_before(tmp_path):
    actor = small_actor(5)
    actor.network.action.fit(torch.tensor([[-0.5, 0.0], [0.5, 0.2]]))
    write_actor(tmp_path, actor)
    again = read_actor(tmp_path)
    assert np.array_equal(actor.predict(seen(10, 20))[0], again.predict(seen(10, 20))[0])
    assert (again.spec, again.network.options, again.seed) == (actor.spec, SMALL, 5)


@pytest.mark.parametrize("change", [{"schema_version": 9}, {"network": {}}, {"spec": None}, {"seed": -1}])
def test_a_document_that_is_no_policy_is_refused(tmp_path, change):
    write_actor(tmp_path, small_actor())
    document = yaml.safe_load((tmp_path / ACTOR_FILE).read_text())
    (tmp_path / ACTOR_FILE).write_text(yaml.safe_dump(document | change))
    with pytest.raises(InputError, match=ACTOR_FILE):
        read_actor(tmp_path)


def test_missing_weights_are_named(tmp_path):
    write_actor(tmp_path, small_actor())
    (tmp_path / WEIGHTS_FILE).unlink()
    with pytest.raises(InputError, match=WEIGHTS_FILE):
        read_actor(tmp_path)
