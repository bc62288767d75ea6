from pathlib import Path

import pytest

from pinwm_drake.paper.baselines.diffusion.demonstrations import read_demonstrations
from pinwm_drake.paper.reproduce.report import read_results
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.run import reproduce, tables_of
from pinwm_drake.parallel import Executor


def test_an_expert_is_recorded_in_the_plant_imitated_and_evaluated(tmp_path: Path):
    pytest.importorskip("diffusers")
    request = ReproduceRequest(tasks=("push",), methods=("diffusion-policy",), episodes=1, quick=True)
    tables = tables_of(["policies"])
    reproduce(tables, request, tmp_path, executor=Executor(workers=1))
    episodes = read_demonstrations(tmp_path / "demonstrations/push/seed-0/episodes")
    assert len(episodes) == 2
    assert episodes[0].image.shape[1:] == (64, 64, 3)
    assert episodes[0].image.min() < 200  # the object, on white
    assert (tmp_path / "policies/push/diffusion-policy/seed-0/training.png").exists()
    (done,) = read_results(tables, request, tmp_path).values()
    assert done is not None
    assert done["result"]["episodes"] == 1
    assert done["settings"]["subject"]["kind"] == "DiffusionCell"
