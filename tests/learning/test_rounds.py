# SPDX-License-Identifier: MIT
import gc
import math
import threading
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pinwm_drake.learning.rounds import Rounds, StageRun, Until


def ended(tmp_path, *results):
    """A stage whose rounds had these successes and lengths; the only weight of each tells its number, from 0."""
    rounds = Rounds(StageRun(tmp_path, "stage"), len(results))
    actor = torch.nn.Linear(1, 1, bias=False)
    for number, (success, length) in enumerate(results):
        torch.nn.init.constant_(actor.weight, number)
        found = SimpleNamespace(success_rate=success, mean_steps=length)
        rounds.end({}, actor, found, steps=1, loss=0.0)
    return rounds


@pytest.mark.parametrize(
    ("results", "best"),
    [
        ([(0.5, 20.0), (0.98, 9.0), (0.98, 9.0), (1.0, 12.0)], 1),  # nearly as much success, shortest, earliest
        ([(0.8, 8.0), (0.9, 11.0), (0.88, 10.0)], 2),  # success comes first
        ([(0.90, 11.0), (0.88, 10.0), (0.86, 9.0)], 1),  # no less than 3 % below the most, also by small steps
        ([(0.80, 8.0), (0.82, 10.0), (0.84, 12.0), (0.84, 11.0)], 3),  # what was dropped does not come back
        ([(0.0, 25.0), (0.0, 25.0), (0.0, 25.0)], 2),  # without any success the one that learned longest
        ([(0.0, 7.0), (0.1, 24.0), (0.0, 5.0)], 1),  # what fails soon is not short
    ],
)
def test_the_best_round_has_most_success_and_then_the_shortest_episodes(tmp_path, results, best):
    rounds = ended(tmp_path, *results)
    assert rounds.best.number == best
    assert rounds.best_weights()["weight"].item() == best
    again = Rounds(StageRun(tmp_path, "stage", resume=True), len(results))
    assert again.best.number == best
    assert np.array_equal(again.best_weights()["weight"], rounds.best_weights()["weight"])


def test_the_thread_of_the_logger_ends_with_the_stage(tmp_path):
    before = set(threading.enumerate())
    rounds = ended(tmp_path, (0.5, 20.0))
    own = set(threading.enumerate()) - before
    assert own
    del rounds
    gc.collect()
    assert not own & set(threading.enumerate())


def test_the_time_that_is_left_is_that_of_the_budget_and_is_told_anew(tmp_path, monkeypatch):
    now, told = [100.0], []
    monkeypatch.setattr("pinwm_drake.learning.rounds.time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr("pinwm_drake.pace.time", SimpleNamespace(monotonic=lambda: now[0]))
    rounds = Rounds(StageRun(tmp_path, "stage", until=Until(minutes=12.0), report=told.append), 100)
    assert (told[-1].done, told[-1].left) == (0.0, 720.0)  # nothing is known but the budget
    now[0] += 60.0
    rounds.tell(0.5)
    # 2 minutes a round would be 199 more minutes: 11 are left.
    assert told[-1].left == pytest.approx(660.0)
    assert told[-1].done == pytest.approx(60.0 / 720.0)
    now[0] += 60.0
    rounds.end({}, torch.nn.Linear(1, 1), SimpleNamespace(success_rate=0.5, mean_steps=9.0), steps=1, loss=0.0)
    now[0] += 600.0
    rounds.tell(0.0)
    assert (told[-1].left, told[-1].done) == (0.0, pytest.approx(0.99))


@pytest.mark.parametrize(("minutes", "shares"), [(10.0, (0.2, 0.3, 0.35)), (math.inf, (0.0, 0.0, 0.0))])
def test_the_share_of_the_minutes_that_is_spent_counts_a_part_of_a_round_by_the_last_one(
    tmp_path, monkeypatch, minutes, shares
):
    now = [100.0]
    monkeypatch.setattr("pinwm_drake.learning.rounds.time", SimpleNamespace(monotonic=lambda: now[0]))
    rounds = Rounds(StageRun(tmp_path, "stage", until=Until(minutes=minutes)), 10)
    found = SimpleNamespace(success_rate=0.5, mean_steps=9.0)
    assert rounds.spent(0.5) == 0.0  # nothing is known of the first one
    for seconds, share in zip((120.0, 60.0), shares[:2], strict=True):
        now[0] += seconds
        rounds.end({}, torch.nn.Linear(1, 1), found, steps=1, loss=0.0)
        assert rounds.spent(0.0) == pytest.approx(share)
    assert rounds.spent(0.5) == pytest.approx(shares[2])


def test_a_first_round_that_takes_longer_than_the_budget_is_waited_for(tmp_path, monkeypatch):
    now, told = [100.0], []
    monkeypatch.setattr("pinwm_drake.learning.rounds.time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr("pinwm_drake.pace.time", SimpleNamespace(monotonic=lambda: now[0]))
    rounds = Rounds(StageRun(tmp_path, "stage", until=Until(minutes=1.0), report=told.append), 10)
    now[0] += 50.0
    rounds.tell(0.25)
    assert told[-1].left == pytest.approx(10.0)  # of the budget: the first unit may hold work that is done once
    now[0] += 50.0
    rounds.tell(0.5)
    # A quarter of the round took 50 s, so 100 s are left of it.
    assert told[-1].left == pytest.approx(100.0)
    assert told[-1].done == pytest.approx(0.5)
