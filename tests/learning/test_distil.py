# SPDX-License-Identifier: MIT
import shutil

import numpy as np
import pytest
import torch
from torch.nn.functional import cross_entropy

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning import distil, rounds
from pinwm_drake.learning.actors import LEVELS, ImageActor, LevelActor
from pinwm_drake.learning.distil import DistilOptions, is_worse, train_distil
from pinwm_drake.learning.images.image_buffer import Chunk, Frames
from pinwm_drake.learning.policy import Policy
from pinwm_drake.learning.rounds import Round, StageRun
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from pinwm_drake.tasks.push import PushTask
from tests.learning.toy_worlds import ToyWorlds, toy_spec

SHORT = DistilOptions(rounds=4, round_images=80, updates=8, batch_size=16, episodes=4)


@pytest.fixture(scope="module")
def teacher():
    """Moves the square to the middle."""
    torch.manual_seed(0)
    actor = LevelActor(PushTask())
    optimizer = torch.optim.Adam(actor.parameters(), 3e-3)
    for _ in range(300):
        state = torch.zeros(256, 11)
        state[:, :2], state[:, 2] = 2.0 * torch.rand(256, 2) - 1.0, 1.0
        state[:, 7:] = torch.randn(256, 4)  # where the pusher is does not matter
        most = len(LEVELS) // 2
        wanted = (-5.0 * most * state[:, :2]).clamp(-most, most).round().long() + most
        loss = cross_entropy(actor.logits(state).flatten(0, 1), wanted.flatten())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return Policy(toy_spec("state"), actor.eval())


class Killed(Exception):
    pass


def weights(policy):
    return {name: value.numpy().copy() for name, value in policy.actor.state_dict().items()}


def test_the_student_learns_to_act_from_images(tmp_path, teacher):
    spec = toy_spec("rgb")
    options = DistilOptions(rounds=4, round_images=800, updates=60, batch_size=64, episodes=16)
    policy = train_distil(ToyWorlds(), teacher, spec, options, StageRun(tmp_path, "distil"))
    assert isinstance(policy.actor, ImageActor)
    found = evaluate_worlds(ToyWorlds(), policy, 64, seed=5)
    torch.manual_seed(0)
    before = evaluate_worlds(ToyWorlds(), Policy(spec, ImageActor(spec)), 64, seed=5)
    assert before.success_rate < 0.5
    assert found.success_rate > 0.9


@pytest.fixture(scope="module")
def whole(tmp_path_factory, teacher):
    """Policy and folder of a distillation that nobody kills."""
    folder = tmp_path_factory.mktemp("whole")
    return train_distil(ToyWorlds(), teacher, toy_spec("rgb"), SHORT, StageRun(folder, "distil")), folder


# While images of the third round are collected, and after all and four of the eight updates of the second.
@pytest.mark.parametrize(("done", "updates"), [(0.51, 0), (0.5, 8), (0.41, 4)])
def test_a_distillation_that_was_killed_goes_on_with_the_same_result(
    tmp_path, teacher, whole, monkeypatch, done, updates
):
    monkeypatch.setattr(rounds, "_PERIOD", 0.0)
    monkeypatch.setattr(distil, "_TOLD", 4)
    spec = toy_spec("rgb")

    def kill(step):
        if step.done >= done:
            raise Killed

    with pytest.raises(Killed):
        train_distil(ToyWorlds(), teacher, spec, SHORT, StageRun(tmp_path / "b", "distil", report=kill))
    kept = tmp_path / "b" / rounds.ROUND_FILE
    assert kept.exists() == (updates > 0)
    if updates:
        with np.load(kept) as file:
            assert len(file["losses"]) == updates
    rest = train_distil(ToyWorlds(), teacher, spec, SHORT, StageRun(tmp_path / "b", "distil", resume=True))
    a, b = weights(whole[0]), weights(rest)
    assert all(np.array_equal(a[name], b[name]) for name in a)
    assert not kept.exists()


def test_the_last_round_is_taken_unless_it_is_worse_than_chance_explains():
    def done(success):
        return Round(0, 0, success, 10.0, 0.0, 0.0)

    assert not is_worse(done(0.75), None, 64)
    assert not is_worse(done(0.70), done(0.81), 64)  # 45 and 52 of 64: p = 0.15
    assert is_worse(done(0.55), done(0.81), 64)
    assert is_worse(done(0.90), done(1.0), 64)
    assert not is_worse(done(0.97), done(1.0), 64)


def test_images_that_are_missing_are_named(tmp_path, teacher, whole):
    folder = shutil.copytree(whole[1], tmp_path / "copy")
    (folder / "images" / "0001.npz").unlink()
    with pytest.raises(InputError, match=r"0001\.npz"):
        train_distil(ToyWorlds(), teacher, toy_spec("rgb"), SHORT, StageRun(folder, "distil", resume=True))


def chunk(worlds, length, first=0):
    """Image values tell row numbers; world 1 begins an episode at its third action."""
    rows = worlds * length
    start = np.zeros((length, worlds), bool)
    start[0] = True
    start[2, 1] = True
    numbers = np.arange(first, first + rows)
    image = np.broadcast_to(numbers[:, None, None, None], (rows, 4, 4, 3)).astype(np.uint8)
    columns = np.tile(numbers[:, None], (1, 11)).astype(np.float32)
    corner = np.stack([numbers, -numbers], 1).astype(np.int16)
    return Chunk(image, start.ravel(), columns[:, :2], columns, columns[:, 2:5], corner)


def test_stacks_hold_images_of_the_same_episode_the_oldest_first():
    frames = Frames(2, 3, 1000)
    frames.add(chunk(2, 4))
    images, pusher, state, goal, corner = frames.draw(400, np.random.default_rng(0))
    stacks = {int(row[0]): stack[0, 0, ::3].tolist() for row, stack in zip(state, images, strict=True)}
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
    assert np.array_equal(pusher[:, 0], state[:, 0])
    assert np.array_equal(goal, state[:, 2:5])
    assert np.array_equal(corner[:, :, 0], images[:, 0, 0, ::3])
    assert np.array_equal(corner[:, :, 1], -corner[:, :, 0])


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
    for name in ("image", "start", "pusher", "state", "goal", "corner"):
        assert np.array_equal(getattr(one, name), getattr(again, name))


@pytest.mark.parametrize("values", [{"rounds": 0}, {"gain": -0.1}, {"learning_rate": float("inf")}])
def test_options_that_make_no_sense_are_refused(values):
    with pytest.raises(ParameterError, match=next(iter(values))):
        DistilOptions(**values)
