# SPDX-License-Identifier: MIT
"""Cells of predictions."""

from pathlib import Path

import numpy as np
import pytest

from pinwm_drake.identification.history import History
from pinwm_drake.paper.baselines.dreamer.policy import read_dreamer
from pinwm_drake.paper.baselines.dreamer.training import read_world_model
from pinwm_drake.paper.one_step import Outcomes, SeenOutcomes
from pinwm_drake.paper.reproduce.predictions import guesses, twin_at
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.run import plan, read_results, reproduce, tables_of, write_report
from pinwm_drake.parallel import Executor
from pinwm_drake.systems.scenario.load import load_setup


def history(lengths, names=("friction_floor", "moment_zz")):
    start = np.array([k for k, n in enumerate(lengths) for _ in range(n)], int)
    iteration = np.array([j for n in lengths for j in range(n)], int)
    theta = np.column_stack([0.1 + 0.01 * np.arange(len(start)), np.full(len(start), 2.0)])
    loss = np.linspace(1.0, 0.1, len(start))
    theta = theta.reshape(len(start), 2)
    return History(iteration, loss, np.array(["coarse"] * len(start)), start, theta, list(names))


def test_guesses_are_those_of_the_start_that_went_farthest():
    rows = guesses(history([5, 20, 5]))
    assert rows[0] == 5
    assert rows[-1] == 24
    assert len(rows) == 8
    assert guesses(history([3])) == [0, 1, 2]
    assert guesses(history([])) == []


def test_a_guess_is_a_twin_with_its_parameters():
    twin = load_setup("push_t").twin
    found = twin_at(twin, history([4]), 2)
    assert found.theta["friction_floor"].value == pytest.approx(0.12)
    assert found.theta["friction_pusher"] == twin.theta["friction_pusher"]
    # Twice the second moment along z alone makes the moments about x and y larger, and leaves that about z.
    assert found.theta["inertia_zz"].value == pytest.approx(twin.theta["inertia_zz"].value)
    assert found.theta["inertia_xx"].value > twin.theta["inertia_xx"].value


def keys(request, root):
    return {cell.key for wave in plan(tables_of(["one-step"]), request, root).waves for cell in wave}


def test_systems_that_are_not_asked_for_have_no_row(tmp_path: Path):
    chosen = keys(ReproduceRequest(tasks=("push",), methods=("asid",)), tmp_path)
    rows = {key for key in chosen if key.startswith("one-step")}
    assert rows == {
        f"{folder}/{name}" for folder in ("one-step", "one-step-at-rest") for name in ("asid/push/seed-0", "scene/push")
    }
    assert {"outcomes/push", "outcomes-at-rest/push"} <= chosen
    assert "twins/pin-wm/push/seed-0" not in chosen
    every = keys(ReproduceRequest(tasks=("push",), seeds=2), tmp_path)
    assert {f"one-step/dreamer-v2/push/seed-{seed}" for seed in (0, 1)} <= every
    assert {"one-step/readout/push", "one-step/2d-physics/push/seed-1", "policies/push/dreamer-v2/seed-1"} <= every


@pytest.mark.nightly
def test_an_action_is_imagined_and_read_beside_the_plants_own_images(tmp_path: Path):
    request = ReproduceRequest(tasks=("push",), methods=("dreamer-v2",), draws=1, quick=True)
    tables = tables_of(["one-step"])
    reproduce(tables, request, tmp_path, executor=Executor(workers=1))
    results = {cell.key: done["result"] for cell, done in read_results(tables, request, tmp_path).items()}
    own = {f"one-step/{name}" for name in ("dreamer-v2/push/seed-0", "readout/push", "scene/push")}
    assert set(results) == own | {"one-step-at-rest/scene/push"}
    read = results["one-step/readout/push"]
    assert read["translation"]["mean"] < 2e-3
    assert read["rotation"]["mean"] < 0.05
    # Hardly trained, the model has no idea.
    assert results["one-step/dreamer-v2/push/seed-0"]["translation"]["mean"] > read["translation"]["mean"]
    outcomes = Outcomes.read(tmp_path / "outcomes/push/outcomes.npz")
    resting = Outcomes.read(tmp_path / "outcomes-at-rest/push/outcomes.npz")
    assert np.linalg.norm(resting.moved, axis=1) > np.linalg.norm(outcomes.moved, axis=1) + 1e-3
    assert float(outcomes.longest) == 0.02  # as policies have it; the pusher could do 0.03
    seen = SeenOutcomes.read(tmp_path / "one-step/readout/push/seen.npz")
    np.testing.assert_allclose(seen.before[:, 4:6], outcomes.p_WO[:, :2], atol=1e-4)
    folder = tmp_path / "policies/push/dreamer-v2/seed-0"
    policy = read_dreamer(folder)
    own, model = policy.perception.state_dict(), read_world_model(folder, policy).perception.state_dict()
    assert all((own[name] == model[name]).all() for name in own)
    write_report(tmp_path / "report.md", tables, request, tmp_path)
    rows = [line.split(" | ")[1] for line in (tmp_path / "report.md").read_text().splitlines() if "| push" in line]
    assert [row.split(":")[0] for row in rows] == ["dreamer-v2", "readout of true images", "the scene's own theta"]
