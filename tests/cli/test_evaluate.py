# SPDX-License-Identifier: MIT
from pathlib import Path

import numpy as np
import pytest
import torch

from pinwm_drake.experiments.evaluation.contestant import read_contestant, scene_of
from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
from pinwm_drake.learning.policy import Policy, make_actor, write_policy
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.policy_scene import policy_spec
from tests.cli.evaluations import document, rows, write_scenario
from tests.systems.stations import action_setup


@pytest.fixture(scope="module")
def scenario(tmp_path_factory) -> str:
    return write_scenario(tmp_path_factory.mktemp("scenario"))


@pytest.fixture(scope="module")
def policies(scenario, tmp_path_factory) -> dict[str, str]:
    """Untrained ones, of images and of the state."""
    folder, setup = tmp_path_factory.mktemp("policies"), action_setup(scenario)
    found = {}
    torch.manual_seed(0)
    for observes in ("rgb", "state"):
        spec = policy_spec(setup, EnvOptions(frames=2, max_translation=0.02, max_steps=6), observes)
        write_policy(folder / observes, Policy(spec, make_actor(spec), {"trained": "never"}))
        found[observes] = str(folder / observes)
    return found


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--episodes", "0"], "--episodes: got 0; allowed: 1 or more"),
        (["--seed", "-1"], "--seed: got -1; allowed: 0 to"),
        (["--yaw", "4"], "--yaw: got 4.0; allowed: 0 to pi"),
        (["--workers", "0"], "--workers: got 0; allowed: 1 or more"),
        (["--model", "push_t"], "--model: got one; allowed: with mpc"),
        (["--engine", "bullet"], "--engine: got 'bullet'; allowed: twin, hydroelastic, point"),
        (["--engine", "lcm"], "--engine: got 'lcm'"),
        (["--tolerance", "0"], "tolerance: got 0.0; allowed: more than 0"),
        (["--max-translation", "1"], "max_translation: got 1.0 m; allowed: more than 0"),
        (["--scene", "push_tea"], "push_tea: no such scenario; allowed: a file"),
    ],
)
def test_what_makes_no_sense_is_refused(pinwm, tmp_path, arguments, message):
    code, _, errors = pinwm("evaluate", "random", "--engine", "twin", "-o", str(tmp_path / "out"), *arguments)
    assert (code, errors.count("\n")) == (1, 1)
    assert message in errors
    assert not (tmp_path / "out").exists()


def test_a_policy_that_ships_goes_by_its_name():
    contestant = read_contestant(EvaluateRequest("push_t"))
    assert (contestant.kind, contestant.observes) == ("bundle", "rgb")


def test_the_scene_that_is_not_named_is_that_of_the_task(policies, tmp_path):
    setup = action_setup("flip_mug")
    spec = policy_spec(setup, EnvOptions(task="flip", frames=2, max_steps=6), "state")
    write_policy(tmp_path / "flips", Policy(spec, make_actor(spec), {"trained": "never"}))
    cases = [("push_t", None), (policies["rgb"], None), (str(tmp_path / "flips"), None), ("mpc", None), ("mpc", "flip")]
    requests = [EvaluateRequest(policy, task=task) for policy, task in cases]
    scenes = [scene_of(read_contestant(one), one).scenario.name for one in requests]
    assert scenes == ["push_t", "push_t", "flip_mug", "push_t", "flip_mug"]


def test_another_object_is_refused_or_asked_for_by_name(pinwm, policies, tmp_path):
    out = ["--engine", "twin", "--episodes", "1", "--workers", "1", "-o", str(tmp_path / "out")]
    code, _, errors = pinwm("evaluate", policies["state"], "--scene", "push_cube", *out)
    block = "t_block, 100 x 140 x 50 mm"
    assert (code, errors) == (
        1,
        f"pinwm: object: got cube, 60 x 60 x 60 mm; allowed: {block}, the policy's; "
        "--other-object evaluates it all the same\n",
    )
    code, _, errors = pinwm("evaluate", "mpc", "--scene", "push_cube", "--model", "t_block", *out)
    assert (code, errors.count("\n")) == (1, 1)
    assert f"--model t_block: got {block}; allowed: cube, 60 x 60 x 60 mm, that of push_cube" in errors


def test_what_is_no_policy_is_refused(pinwm, policies, tmp_path):
    code, _, errors = pinwm("evaluate", str(tmp_path / "none"))
    assert (code, errors) == (
        1,
        f"pinwm: {tmp_path}/none: no such folder; allowed: a policy, a bundle, flip_mug, push_t, mpc or random\n",
    )
    code, _, errors = pinwm("evaluate", str(tmp_path))
    assert code == 1
    assert "got a folder without policy.yaml" in errors
    code, _, errors = pinwm("evaluate", policies["state"], "--max-translation", "0.01")
    assert code == 1
    assert "--max-translation: got one beside a policy, which has its own" in errors
    code, _, errors = pinwm("evaluate", policies["rgb"], "--scene", "push_t", "--engine", "twin")
    assert code == 1
    assert "pusher's box" in errors


@pytest.mark.parametrize("observes", ["rgb", "state"])
def test_a_policy_is_given_what_it_is_made_for(pinwm, scenario, policies, tmp_path, observes):
    options = ["--scene", scenario, "--engine", "twin", "--episodes", "2", "--workers", "1", "-o", str(tmp_path)]
    code, _, errors = pinwm("evaluate", policies[observes], *options)
    assert (code, errors) == (0, "")
    found = document(tmp_path)
    assert found["settings"]["max_steps"] == 6
    assert found["settings"]["max_translation"] == 0.02
    assert found["settings"]["observes"] == observes
    assert found["settings"]["image"] == ([32, 32] if observes == "rgb" else None)
    assert found["provenance"]["policy_provenance"] == {"trained": "never"}
    kept = np.load(tmp_path / "episodes/000000.npz", allow_pickle=False)
    steps = int(kept["steps"])
    assert kept["p_WO"].shape == (steps + 1, 3)
    assert kept["views"].shape == ((len(kept["at"]), 32, 32, 3) if observes == "rgb" else (0, 0, 0, 3))
    page = (tmp_path / "report.html").read_text()
    assert ("policy's" in page) == (observes == "rgb")
    assert f"<title>Evaluation of {policies[observes]}: t_block in small push, twin</title>" in page
    assert found["provenance"]["object"] == "t_block"


def test_tolerances_and_yaw_are_those_asked_for(pinwm, scenario, policies, tmp_path):
    options = ["--scene", scenario, "--engine", "twin", "--episodes", "4", "--workers", "1", "-o", str(tmp_path)]
    wide = ["--tolerance", "0.2", "--turn-tolerance", "3.3", "--yaw", "3.1", "--seed", "1"]
    code, _, errors = pinwm("evaluate", policies["state"], *options, *wide)
    assert (code, errors) == (0, "")
    assert max(abs(float(row["start_yaw"])) for row in rows(tmp_path)) > 1.0
    assert {row["outcome"] for row in rows(tmp_path)} == {"success"}
    assert document(tmp_path)["settings"]["start_yaw"] == [-3.1, 3.1]


@pytest.mark.nightly
def test_a_bundle_does_what_its_policy_does(pinwm, scenario, policies, tmp_path):
    from pinwm_drake.learning.export import export_policy
    from pinwm_drake.learning.policy import read_policy
    from pinwm_drake.learning.safety import default_limits

    policy, random = read_policy(Path(policies["rgb"])), np.random.default_rng(0)
    images = random.integers(0, 256, (4, *policy.spec.image_shape), dtype=np.uint8)
    samples = (images, random.uniform(-0.2, 0.2, (4, 2)))
    export_policy(policy, tmp_path / "bundle", limits=default_limits(policy.spec), samples=samples)
    tables = []
    for name in (policies["rgb"], str(tmp_path / "bundle")):
        out = tmp_path / f"out{len(tables)}"
        options = ["--scene", scenario, "--engine", "twin", "--episodes", "2", "--workers", "1", "-o", str(out)]
        code, _, errors = pinwm("evaluate", name, *options)
        assert (code, errors) == (0, "")
        tables.append([[float(row[key]) for key in ("steps", "distance", "angle")] for row in rows(out)])
    np.testing.assert_allclose(*tables, atol=1e-4)
    assert document(tmp_path / "out1")["settings"]["policy"] == "bundle"


def test_the_controller_that_plans_is_evaluated_too(pinwm, tmp_path):
    options = ["--engine", "twin", "--episodes", "1", "--workers", "1", "--max-translation", "0.03"]
    code, _, errors = pinwm("evaluate", "mpc", "--model", "push_t", *options, "-o", str(tmp_path))
    assert (code, errors) == (0, "")
    assert rows(tmp_path)[0]["outcome"] == "success"
    assert document(tmp_path)["provenance"]["policy_provenance"]["theta"]["friction_floor"] == 0.03
