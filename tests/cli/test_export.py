# SPDX-License-Identifier: MIT
import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from pinwm_drake.experiments.golden_samples import export_bundle
from pinwm_drake.learning.bundle import HASHED, PROVENANCE_FILE, read_bundle
from pinwm_drake.learning.policy import Policy, make_actor, write_policy
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.models import policy_path
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.policy_scene import policy_spec
from tests.systems.stations import action_setup

pytestmark = pytest.mark.usefixtures("read_operators_once")

SIZE = 32


@pytest.fixture(scope="module")
def policy() -> Policy:
    """An untrained one of the shipped scene, which is decided all the same."""
    setup = action_setup("push_t", image_size=SIZE)
    spec = policy_spec(setup, EnvOptions(frames=2, max_translation=0.02, max_steps=100), "rgb")
    torch.manual_seed(0)
    actor = make_actor(spec)
    with torch.no_grad():
        actor.head.weight.mul_(20.0)
    return Policy(spec, actor, {"twin": "push_t", "note": "untrained"})


@pytest.fixture(scope="module")
def folder(tmp_path_factory, policy) -> Path:
    path = tmp_path_factory.mktemp("policy") / "best"
    write_policy(path, policy)
    return path


def test_a_bundle_is_written_with_what_the_policy_sees(pinwm, folder, policy, tmp_path):
    out = tmp_path / "new/bundle"
    options = ["--max-speed", "0.1", "--box-low", "-0.2", "-0.25", "0.02", "--seed", "3"]
    code, output, errors = pinwm("export", str(folder), str(out), *options)
    assert (code, errors) == (0, "")
    assert sorted(path.name for path in out.iterdir()) == sorted((*HASHED, PROVENANCE_FILE))
    bundle = read_bundle(out)
    assert bundle.network.estimates
    assert bundle.spec == policy.spec
    assert bundle.limits == dataclasses.replace(default_limits(policy.spec), max_speed=0.1, box_low=(-0.2, -0.25, 0.02))
    assert bundle.provenance["policy"] == policy.provenance
    with np.load(out / "golden.npz") as golden:
        images, p_WP = golden["image"][:-4], golden["pusher_position"][:-4]
    assert images.shape == (12, SIZE, SIZE, 6)
    seen = (images.min(axis=3) < 250).mean(axis=(1, 2))
    assert ((seen > 0.01) & (seen < 0.5)).all()  # a block on white
    # Three starts, in each of which first both images are the same and then the pusher moves.
    assert [np.array_equal(image[..., :3], image[..., 3:]) for image in images[::4]] == [True] * 3
    assert len(np.unique(p_WP.round(4), axis=0)) == 12
    lines = output.splitlines()
    assert lines[0].startswith(
        "limits: 0.1 m/s, 4 m/s^2, image no older than 0.2 s, pusher within -0.2 -0.25 0.02 to 0.35"
    )
    assert lines[1].startswith("16 golden samples; onnxruntime is ")
    assert lines[2].endswith(" ms a call on one core")
    assert lines[3].startswith("KUKA LBR iiwa 14 follows the policy: the way of an action is off by ")
    assert lines[4].startswith("Franka Emika Panda follows the policy: ")
    assert [one["arm"] for one in bundle.contract["arms"]] == ["iiwa", "panda"]
    assert [line.split()[1] for line in lines[5:9]] == [str(path) for path in sorted(out.iterdir())]
    assert lines[9] == f"SHA-256 of the bundle: {bundle.sha256}"


def without_window(policy: Policy, **changes) -> Policy:
    """A policy that sees all of its images, as older ones do."""
    spec = dataclasses.replace(policy.spec, window=None)
    return Policy(dataclasses.replace(spec, **changes), make_actor(spec))


def test_a_policy_without_a_scene_gets_that_of_the_command(folder, policy, tmp_path):
    write_policy(tmp_path / "policy", without_window(policy, scene=None))
    bundle = export_bundle(tmp_path / "policy", tmp_path / "bundle", scene="push_t", arms=False)
    assert bundle.spec == without_window(policy).spec
    assert "arms" not in bundle.contract


def test_wrong_input_is_one_line_and_exit_with_1(pinwm, folder, policy, tmp_path):
    out, state, other = tmp_path / "out", tmp_path / "state", tmp_path / "other"
    spec = dataclasses.replace(policy.spec, observes="state")
    write_policy(state, Policy(spec, make_actor(spec)))
    write_policy(other, Policy(dataclasses.replace(policy.spec, horizon=0.2), policy.actor))
    for arguments, message in (
        ([str(folder), "--seed", "-1"], "--seed: got -1; allowed: 0 or more"),
        ([str(folder), "--max-speed", "0"], "--max-speed: got 0.0; allowed: more than 0 m/s"),
        ([str(folder), "--max-image-age", "inf"], "--max-image-age: got inf; allowed: more than 0 s"),
        ([str(folder), "--box-high", "-1", "0", "1"], "box_low, box_high: got [-0.35, -0.35, "),
        ([str(state)], "policy: got one that observes state; allowed: rgb"),
        ([str(tmp_path)], f"{tmp_path / 'policy.yaml'}: no such file"),
        ([str(other)], "horizon: got 0.1 s; allowed: 0.2 s, the policy's"),
        ([str(folder), "--scene", "nowhere"], ""),
    ):
        code, output, errors = pinwm("export", arguments[0], str(out), *arguments[1:])
        assert (code, output, errors.count("\n")) == (1, "", 1)
        assert errors.startswith(f"pinwm: {message}")
    code, _, errors = pinwm("export", str(policy_path("push_t")), str(out))
    assert (code, errors.endswith("push_t: got a bundle; allowed: a policy, as `pinwm train` wrote it\n")) == (1, True)
    assert not out.exists()
    out.mkdir()
    (out / "mine").write_text("")
    code, _, errors = pinwm("export", str(folder), str(out))
    assert (code, errors) == (1, f"pinwm: {out}: got something there already; allowed: a new or empty folder\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other", "out", "state"]
