# SPDX-License-Identifier: MIT
"""Diffusion policy learns to go around a disc by either of two ways."""

import pytest

from benchmarks.way_around.methods import around_method
from benchmarks.way_around.worlds import Anyhow, AroundWorlds, Expert, MakeAround, sides, success
from pinwm_drake.learning.method import MethodData
from pinwm_drake.learning.progress import silent
from pinwm_drake.paper.baselines.diffusion.demonstrations import collect_demonstrations

pytest.importorskip("diffusers")
UPDATES = 1600


@pytest.mark.nightly
def test_both_ways_are_learned(tmp_path):
    folder, worlds, method = tmp_path / "demonstrations", MakeAround(), around_method(UPDATES, 1)
    collect_demonstrations(AroundWorlds(), Expert(), folder, 50)
    actor = method.train(MethodData(folder), worlds, tmp_path, seed=0, resume=False, report=silent)
    assert success(actor, 100).interval[0] > 0.3
    assert success(Anyhow(), 100).success_rate < 0.05
    # In the episodes in which it succeeds it takes both ways.
    collect_demonstrations(AroundWorlds(), actor, tmp_path / "own", 20)
    assert set(sides(tmp_path / "own")) == {-1.0, 1.0}
