# SPDX-License-Identifier: MIT
import math
from dataclasses import replace

import pytest

from pinwm_drake.experiments.forecast import Forecast, _Clock, _kept, forecast, within
from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.learning.distil import DistilOptions
from pinwm_drake.learning.pin_wm import Distillation, StateSac
from pinwm_drake.learning.ppo import PpoOptions
from pinwm_drake.learning.progress import Step
from pinwm_drake.learning.sac import SacOptions
from tests.learning.bundles import image_spec

pytestmark = pytest.mark.usefixtures("read_operators_once")

SHORT = {"worlds": 4, "image_size": 48, "frames": 2, "threads": 1, "episodes": 4}


def told(monkeypatch, times, steps):
    """Clock that was told of these times and numbers of steps."""
    clock, moments = _Clock(), iter(times)
    monkeypatch.setattr("pinwm_drake.experiments.forecast.time.monotonic", lambda: next(moments))
    for number in steps:
        clock(Step("a", 0.0, number, 0.0, 0.0, 0.0, 0.0, 0.0))
    return clock


def test_a_round_is_counted_by_its_actions_updates_and_evaluation(monkeypatch):
    # 10 actions in 2 s, 10 updates in 1 s, an evaluation of 4 episodes in 4 s.
    clock = told(monkeypatch, [0.0, 5.0, 7.0, 20.0, 21.0, 25.0], [0, 40, 80, 80, 80, 80])
    options = DistilOptions(rounds=3, round_images=400, updates=50, episodes=8)
    assert clock.seconds(Distillation(options=options), 4) == pytest.approx(3 * (100 * 0.2 + 50 * 0.1 + 8.0))


def test_steps_are_counted_by_the_second_half_of_a_brief_training(monkeypatch):
    clock = told(monkeypatch, [0.0, 9.0, 11.0, 14.0], [0, 80, 160, 160])
    stage = StateSac(SacOptions(steps=1000, round_steps=400, episodes=8))
    assert clock.seconds(stage, 4) == pytest.approx(1000 * 2.0 / 80 + 3 * 6.0)


@pytest.mark.parametrize(
    ("values", "stages"),
    [
        ({}, ["teacher", "distil"]),
        pytest.param({"method": "ppo"}, ["ppo"], marks=pytest.mark.nightly),
        ({"method": "state", "algorithm": "ppo"}, ["teacher"]),
    ],
)
def test_every_stage_is_forecast(tmp_path, values, stages):
    found = forecast(TrainRequest("push_t", tmp_path / "run", **SHORT, **values))
    assert list(found.minutes) == stages
    assert min(found.minutes.values()) > 0.0
    assert 0.1 < found.memory < 20.0
    assert not (tmp_path / "run").exists()


def test_a_budget_limits_the_forecast_but_for_the_first_round_of_a_stage(tmp_path, monkeypatch):
    # 100 rounds of 3 minutes each: all of them, as many as there is time for, and one in any case.
    assert within(math.inf, 300.0, 100) == 300.0
    assert within(12.0, 300.0, 100) == 12.0
    assert within(2.0, 300.0, 100) == 3.0
    # Ten hours a stage without end, in rounds of 0.6 minutes: the teacher has half of the budget, the student the rest.
    monkeypatch.setattr(_Clock, "seconds", lambda *_: 36000.0)
    monkeypatch.setattr(_Clock, "rounds", lambda *_: 1000)
    found = forecast(TrainRequest("push_t", tmp_path / "run", **SHORT, minutes=12.0))
    assert found.minutes == {"teacher": 6.0, "distil": 6.0}
    assert str(found).startswith("up to 12 minutes (teacher 6 and distil 6)")
    assert "in any case" not in str(found)


def test_a_budget_that_is_shorter_than_the_first_rounds_is_told():
    words = str(Forecast({"teacher": 9.0, "distil": 11.0}, 1.3, 12.0))
    assert words.endswith("memory; one round of each stage takes more than --minutes 12, and is done in any case")
    assert "case" not in str(Forecast({"teacher": 6.0, "distil": 6.0}, 1.3, 12.0))


def test_all_is_told_in_a_line():
    words = str(Forecast({"teacher": 9.2, "distil": 11.1}, 1.26))
    assert words == "up to 20 minutes (teacher 9 and distil 11) and 1.3 GiB of memory"
    assert str(Forecast({"teacher": 0.2, "distil": 0.3}, 0.84)) == "less than a minute and 0.8 GiB of memory"


def test_memory_is_that_of_what_is_learned_from():
    spec = image_spec()
    height, width, channels = spec.image_shape
    assert _kept(DistilOptions(rounds=2, round_images=100), spec, 4) == 200 * height * width * 3
    assert _kept(PpoOptions(n_steps=16), spec, 4) == 64 * height * width * channels
    assert _kept(SacOptions(steps=1000), spec, 4) == 1000 * 4 * (2 * 11 + 2 + 3)
    past = replace(spec, history=1)
    assert _kept(SacOptions(steps=1000), past, 4) == 1000 * 4 * (2 * (11 + 11 + 2) + 2 + 3)
