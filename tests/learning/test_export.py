# SPDX-License-Identifier: MIT
import dataclasses
import datetime
import json
import re
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning import export
from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.learning.bundle import ONNX_FILE, Bundle, read_bundle
from pinwm_drake.learning.export import InMetres, check_exportable, export_policy, golden_samples
from pinwm_drake.learning.golden import TOLERANCE
from pinwm_drake.learning.policy import Policy
from pinwm_drake.learning.safety import default_limits
from tests.learning.bundles import HIGH, LONGEST, LOW, exported, image_spec, pictures, untrained_policy

SPEC = image_spec()


@pytest.fixture(scope="module")
def policy() -> Policy:
    return untrained_policy(SPEC)


def test_a_network_that_cannot_be_exported_is_told_before_it_is_trained(monkeypatch):
    check_exportable(SPEC)

    class Silent(ImageActor):
        def state(self, image, pusher, goal=None, corner=None):
            return super().state(image.relu() if image.max() > 100 else -image, pusher)

    monkeypatch.setattr(export, "make_actor", Silent)
    with pytest.raises(ParameterError, match="torch cannot export"):
        check_exportable(SPEC)


@pytest.fixture(scope="module")
def place(tmp_path_factory, policy) -> Path:
    return exported(tmp_path_factory.mktemp("export") / "bundle", policy)


@pytest.fixture(scope="module")
def bundle(place) -> Bundle:
    return read_bundle(place)


@pytest.fixture
def same_network(place, monkeypatch):
    """Export writes the network that is there already, whatever the policy is."""
    content = (place / ONNX_FILE).read_bytes()
    monkeypatch.setattr(export, "onnx_bytes", lambda *_, **__: content)


@pytest.fixture(scope="module")
def model(place) -> onnx.ModelProto:
    return onnx.load(place / ONNX_FILE, load_external_data=False)


def in_metres(policy: Policy, images: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
    """What the policy does, by the words of its specification."""
    pusher = [[np.interp(p[k], [LOW[k], HIGH[k]], [-1, 1]) for k in (0, 1)] for p in p_WP]
    actions, _ = policy.predict({"image": images, "pusher": np.array(pusher)})
    return np.array([LONGEST * a / max(1.0, np.hypot(*a)) for a in actions.astype(float)])


def test_a_bundle_does_what_the_policy_does(policy, bundle):
    generator = np.random.default_rng(3)
    images = np.concatenate([pictures(SPEC, 30)[0], generator.integers(0, 256, (10, *SPEC.image_shape), np.uint8)])
    p_WP = generator.uniform(-0.5, 0.5, (40, 2))
    expected = in_metres(policy, images, p_WP)
    found = np.array([bundle.act(*one) for one in zip(images, p_WP, strict=True)])
    assert (found.shape, found.dtype) == ((40, 2), float)
    assert np.abs(found - expected).max() <= TOLERANCE == 1e-5
    # All that is in the network beside the actor is needed here: some are cut, some shortened, some neither.
    lengths = np.linalg.norm(expected, axis=1)
    assert (lengths > 0.999 * LONGEST).any()
    assert (lengths < 0.9 * LONGEST).any()
    assert np.ptp(expected, axis=0).min() > 0.5 * LONGEST
    assert np.linalg.norm(found, axis=1).max() <= LONGEST * (1 + 1e-6)


def test_the_network_in_torch_takes_no_batch_and_leaves_the_actor_alone(policy):
    policy.actor.train()
    network = InMetres(SPEC, policy.actor)
    assert policy.actor.training
    policy.actor.eval()
    images, p_WP = pictures(SPEC, 1)
    with torch.inference_mode():
        d_W, _ = network(torch.from_numpy(images[0]), torch.from_numpy(p_WP[0].astype(np.float32)))
    assert d_W.numpy() == pytest.approx(in_metres(policy, images, p_WP)[0], abs=2e-7)


def test_the_onnx_file_is_whole_and_tells_nothing_of_this_machine(model):
    onnx.checker.check_model(model, full_check=True)
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", 18)]
    weights = [tensor.name for tensor in model.graph.initializer if len(tensor.dims) >= 2]
    assert len(weights) >= 6  # three convolutions, a layer after them, and two of the actor
    for tensor in model.graph.initializer:
        assert tensor.data_location == onnx.TensorProto.DEFAULT
        assert not tensor.external_data
    assert not re.search(rb"\.py|/home|/work|site-packages", model.SerializeToString())


def test_export_says_nothing(policy, capfd, recwarn):
    export.onnx_bytes(policy)
    assert capfd.readouterr() == ("", "")
    assert [str(each.message) for each in recwarn] == []


def test_contract_and_provenance_say_what_there_is(policy, bundle):
    contract, provenance = bundle.contract, bundle.provenance
    image, position = contract["inputs"]
    translation, estimate = contract["outputs"]
    keys = ("name", "dtype", "shape", "unit", "frame", "rate", "latency")
    assert [image[key] for key in keys] == ["image", "uint8", [32, 32, 6], "sRGB, 0 to 255", "C", 10.0, 0.0]
    assert [position[key] for key in keys] == ["pusher_position", "float32", [2], "m", "W", 10.0, 0.0]
    assert [translation[key] for key in keys] == ["pusher_translation", "float32", [2], "m", "W", 10.0, 0.0]
    assert [estimate[key] for key in ("name", "dtype", "shape")] == ["state_estimate", "float32", [11]]
    assert estimate["unit"] == ["0.1 m"] * 2 + ["1"] * 2 + ["0.3 m/s"] * 2 + ["3 rad/s"] + ["0.1 m"] * 4
    assert len(estimate["meaning"]) == 11
    assert {entry["period"] for entry in (image, position, translation, estimate)} == {0.1}
    assert image["max_latency"] == bundle.limits.max_image_age
    assert {"quaternions", "O", "mask", "latency", "success"} < set(contract["notes"])
    assert {"rest_speed", "rest_turn"} < set(contract["spec"]["task"])
    assert (translation["horizon"], translation["max_translation"]) == (0.1, LONGEST)
    assert image["camera"] == dataclasses.asdict(SPEC.camera) | {"p_WC": [0, 0, 1], "q_WC": [0, 1, 0, 0]}
    assert contract["onnx"] == {"opset": 18}
    assert (bundle.spec, bundle.limits) == (SPEC, default_limits(SPEC))
    assert contract["safety"]["max_speed"] == pytest.approx(0.2)
    assert provenance["policy"] == policy.provenance
    assert provenance["golden"]["samples"] == 6 + 4
    assert 0 <= provenance["golden"]["deviation_from_torch"] < TOLERANCE
    assert {"torch", "onnx", "onnxscript", "onnxruntime", "pinwm_drake"} < set(provenance["versions"])


def test_golden_samples_hold_the_policys_own_answers(policy):
    images, p_WP = pictures(SPEC)
    golden = golden_samples(policy, images, p_WP)
    # Single precision, through a network and back: 2e-8 m were seen.
    assert golden.d_W == pytest.approx(in_metres(policy, golden.images, golden.p_WP), abs=2e-7)
    assert np.array_equal(golden.images[:6], images)
    # Beyond the box too, where the position is to be cut.
    assert (golden.p_WP.min(axis=0) < LOW).all()


def test_a_policy_that_was_not_taught_the_state_tells_no_estimate(policy, tmp_path):
    limits, samples = default_limits(SPEC), pictures(SPEC)
    bundle = export_policy(policy, tmp_path / "bundle", limits=limits, samples=samples, estimate=False)
    assert not bundle.network.estimates
    assert len(bundle.contract["outputs"]) == 1
    d_W, estimate = bundle.step(samples[0][0], samples[1][0])
    assert estimate is None
    assert d_W == pytest.approx(in_metres(policy, *samples)[0], abs=TOLERANCE)


def test_a_history_follows_the_position_in_metres(tmp_path):
    spec = image_spec(16, 3, history=2)
    policy, (images, _) = untrained_policy(spec), pictures(spec)
    pusher = np.random.default_rng(3).uniform(-0.9, 0.9, (len(images), 10)).astype(np.float32)
    low, high = np.array(LOW), np.array(HIGH)
    place = lambda part: low + (part + 1.0) / 2.0 * (high - low)  # noqa: E731
    now, before, asked, earlier, asked_earlier = np.split(pusher.astype(float), 5, axis=1)
    p_WP = np.hstack([place(now), place(before), LONGEST * asked, place(earlier), LONGEST * asked_earlier])
    bundle = export_policy(policy, tmp_path / "bundle", limits=default_limits(spec), samples=(images, p_WP))
    assert bundle.contract["inputs"][1]["shape"] == [10]
    assert "last 2 actions" in bundle.contract["inputs"][1]["meaning"]
    seen = {"image": images, "pusher": pusher}
    actions, _ = policy.predict(seen)
    wanted = actions / np.maximum(np.linalg.norm(actions, axis=1, keepdims=True), 1.0)
    np.testing.assert_allclose(bundle.predict(seen)[0], wanted, atol=1e-4)
    d_W = np.array([bundle.act(*one) for one in zip(images, p_WP, strict=True)])
    np.testing.assert_allclose(d_W, LONGEST * wanted, atol=TOLERANCE)
    p_WP[:, 2:] = np.hstack([p_WP[:, :2], 0.0 * p_WP[:, :2]] * 2)
    other = np.array([bundle.act(*one) for one in zip(images, p_WP, strict=True)])
    assert np.abs(d_W - other).max() > 1e-4  # the history counts


def test_what_cannot_be_exported_is_refused(policy, tmp_path):
    images, p_WP = pictures(SPEC)
    limits, out = default_limits(SPEC), tmp_path / "bundle"

    def refused(policy: Policy, images: np.ndarray, p_WP: np.ndarray) -> str:
        with pytest.raises(ParameterError) as error:
            export_policy(policy, out, limits=limits, samples=(images, p_WP))
        return str(error.value)

    state = Policy(dataclasses.replace(SPEC, observes="state"), policy.actor)
    assert refused(state, images, p_WP).startswith("policy: got one that observes state; allowed: rgb")
    assert "got images of float64 (6, 32, 32, 6); allowed: uint8 (n, 32, 32, 6)" in refused(policy, images * 1.0, p_WP)
    assert "got images of uint8 (0, 32, 32, 6)" in refused(policy, images[:0], p_WP[:0])
    assert "got positions (5, 2); allowed: (6, 2)" in refused(policy, images, p_WP[1:])
    assert "got positions (6, 2); allowed: (6, 2) finite" in refused(policy, images, p_WP * np.nan)
    broken = untrained_policy(SPEC, gain=float("nan"))
    assert refused(broken, images, p_WP).startswith("policy: its actions are not finite numbers")
    assert not out.exists()


@pytest.mark.usefixtures("same_network")
def test_a_bundle_appears_whole_or_not_at_all(policy, tmp_path):
    out = tmp_path / "bundle"
    other = untrained_policy(SPEC, gain=-1.4)
    with pytest.raises(InputError, match=r"golden\.npz, row \d+: got .* m off; allowed: 1e-05 m between the two"):
        exported(out, other)
    assert list(tmp_path.iterdir()) == []
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="something there already"):
        exported(out, policy)
    assert [path.name for path in out.iterdir()] == ["notes.txt"]


@pytest.mark.usefixtures("same_network")
def test_provenance_may_hold_what_yaml_can(policy, tmp_path):
    told = {"made": datetime.date(2026, 1, 2), "steps": {1: 2.5}, "name": "Größe"}
    folder = exported(tmp_path / "bundle", Policy(SPEC, policy.actor, told))
    assert read_bundle(folder).provenance["policy"] == {"made": "2026-01-02", "steps": {"1": 2.5}, "name": "Größe"}
    assert json.loads((folder / "provenance.json").read_text())["schema_version"] == 2
