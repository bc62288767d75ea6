# SPDX-License-Identifier: MIT
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pinwm_drake.learning.rounds import Rounds, StageRun


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
        ([(0.5, 20.0), (0.9, 9.0), (0.9, 9.0), (1.0, 12.0)], 1),  # the shortest, the earliest of several
        ([(0.0, 25.0), (0.0, 25.0), (0.0, 25.0)], 2),  # without any success the one that learned longest
        ([(0.0, 7.0), (0.1, 24.0), (0.0, 5.0)], 1),  # what fails soon is not short
    ],
)
def test_the_best_round_is_the_shortest_that_had_a_success(tmp_path, results, best):
    rounds = ended(tmp_path, *results)
    assert rounds.best.number == best
    assert rounds.best_weights()["weight"].item() == best
    again = Rounds(StageRun(tmp_path, "stage", resume=True), len(results))
    assert again.best.number == best
    assert np.array_equal(again.best_weights()["weight"], rounds.best_weights()["weight"])
