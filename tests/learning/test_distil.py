import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning.actors import LEVELS, ImageActor
from pinwm_drake.learning.distil import DistilOptions, train_distil
from pinwm_drake.learning.frames import Chunk, Frames
from pinwm_drake.learning.policy import Policy
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from tests.learning.toy_worlds import ToyWorlds, toy_spec

SHORT = DistilOptions(rounds=4, round_images=160, updates=8, batch_size=32, episodes=8)


class Teacher:
    """Moves the square to the middle."""

    def predict(self, observation):
        return np.clip(-5.0 * observation["state"][:, :2], -1.0, 1.0).astype(np.float32), None

    def shares(self, observation):
        gaps = np.abs(self.predict(observation)[0][..., None] - np.array(LEVELS))
        return np.maximum(1.0 - 3.0 * gaps, 0.0)  # of the two levels beside the action


class Killed(Exception):
    pass


def weights(policy):
    return {name: value.numpy().copy() for name, value in policy.actor.state_dict().items()}


def test_the_student_learns_to_act_from_images(tmp_path):
    spec = toy_spec("rgb")
    options = DistilOptions(rounds=4, round_images=1600, updates=120, batch_size=64, episodes=32)
    policy = train_distil(ToyWorlds(), Teacher(), spec, tmp_path, options)
    assert isinstance(policy.actor, ImageActor)
    found = evaluate_worlds(ToyWorlds(), policy, 64, seed=5)
    torch.manual_seed(0)
    before = evaluate_worlds(ToyWorlds(), Policy(spec, ImageActor(*spec.image_shape)), 64, seed=5)
    assert before.success_rate < 0.5
    assert found.success_rate > 0.9


def test_a_distillation_that_was_killed_goes_on_with_the_same_result(tmp_path):
    spec = toy_spec("rgb")
    whole = train_distil(ToyWorlds(), Teacher(), spec, tmp_path / "a", SHORT)

    def kill(step):
        if step.done > 0.4:
            raise Killed

    with pytest.raises(Killed):
        train_distil(ToyWorlds(), Teacher(), spec, tmp_path / "b", SHORT, report=kill)
    rest = train_distil(ToyWorlds(), Teacher(), spec, tmp_path / "b", SHORT, resume=True)
    a, b = weights(whole), weights(rest)
    assert all(np.array_equal(a[name], b[name]) for name in a)


def test_images_that_are_missing_are_named(tmp_path):
    spec = toy_spec("rgb")
    train_distil(ToyWorlds(), Teacher(), spec, tmp_path, SHORT)
    (tmp_path / "images" / "0001.npz").unlink()
    with pytest.raises(InputError, match=r"0001\.npz"):
        train_distil(ToyWorlds(), Teacher(), spec, tmp_path, SHORT, resume=True)


def chunk(worlds, length, first=0):
    """Image values tell row numbers; world 1 begins an episode at its third action."""
    rows = worlds * length
    start = np.zeros((length, worlds), bool)
    start[0] = True
    start[2, 1] = True
    numbers = np.arange(first, first + rows)
    image = np.broadcast_to(numbers[:, None, None, None], (rows, 4, 4, 3)).astype(np.uint8)
    column = np.tile(numbers[:, None], (1, 4)).astype(np.float32)
    return Chunk(image, start.ravel(), column[:, :2], column, np.tile(column[:, :2, None], (1, 1, len(LEVELS))))


def test_stacks_hold_images_of_the_same_episode_the_oldest_first():
    frames = Frames(2, 3, 1000)
    frames.add(chunk(2, 4))
    images, pusher, pose, shares = frames.draw(400, np.random.default_rng(0))
    stacks = {int(row[0]): stack[0, 0, ::3].tolist() for row, stack in zip(pose, images, strict=True)}
    assert stacks == {
        0: [0, 0, 0],
        1: [1, 1, 1],
        2: [0, 0, 2],
        3: [1, 1, 3],
        4: [0, 2, 4],
        5: [5, 5, 5],
        6: [2, 4, 6],
        7: [5, 5, 7],
    }
    assert np.array_equal(pusher[:, 0], pose[:, 0])
    assert np.array_equal(shares[:, 0, 0], pose[:, 0])


def test_the_oldest_images_are_forgotten():
    frames = Frames(2, 1, 17)
    for number in range(3):
        frames.add(chunk(2, 4, first=8 * number))
    assert len(frames) == 16
    assert set(frames.draw(300, np.random.default_rng(0))[2][:, 0].astype(int)) == set(range(8, 24))


def test_a_chunk_is_read_as_it_was_written(tmp_path):
    one = chunk(2, 4)
    one.write(tmp_path / "0.npz")
    again = Chunk.read(tmp_path / "0.npz")
    for name in ("image", "start", "pusher", "pose", "shares"):
        assert np.array_equal(getattr(one, name), getattr(again, name))


@pytest.mark.parametrize("values", [{"rounds": 0}, {"gain": -0.1}, {"learning_rate": float("inf")}])
def test_options_that_make_no_sense_are_refused(values):
    with pytest.raises(ParameterError, match=next(iter(values))):
        DistilOptions(**values)
