import json

import numpy as np
import onnx
import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.learning.bundle import GOLDEN_FILE, ONNX_FILE, PROVENANCE_FILE, read_bundle
from pinwm_drake.learning.upgrade import upgrade_bundle, with_estimate
from tests.learning.bundles import SCENE, as_version_1, image_spec, pictures, rehash


@pytest.fixture
def old(folder, tmp_path):
    return as_version_1(folder, tmp_path / "old")


def golden(folder):
    with np.load(folder / GOLDEN_FILE) as file:
        return dict(file)


def test_a_bundle_of_version_1_becomes_what_is_exported_today(folder, old, tmp_path):
    bundle, today = upgrade_bundle(old, tmp_path / "new", SCENE), read_bundle(folder)
    assert bundle.sha256 == read_bundle(tmp_path / "new").sha256
    assert bundle.contract == today.contract
    assert (bundle.spec, bundle.limits, bundle.mask_pixels) == (today.spec, today.limits, today.mask_pixels)
    before, after, exported = golden(old), golden(tmp_path / "new"), golden(folder)
    for name, array in before.items():
        assert np.array_equal(after[name], array)
    assert after["state_estimate"] == pytest.approx(exported["state_estimate"], abs=1e-5)
    images, p_WP = pictures(image_spec(16, 1), 20)
    for image, p in zip(images, p_WP, strict=True):
        d_W, estimate = bundle.step(image, p)
        assert np.array_equal(d_W, read_bundle(old).act(image, p))
        assert estimate == pytest.approx(today.step(image, p)[1], abs=1e-5)
    assert bundle.provenance["policy"] == today.provenance["policy"]
    assert bundle.provenance["upgraded"]["from_sha256"] == read_bundle(old).sha256


def test_limits_may_be_other_ones(old, tmp_path):
    assert upgrade_bundle(old, tmp_path / "new", SCENE, {"max_speed": 0.05}).limits.max_speed == 0.05


def test_an_estimate_that_was_not_taught_is_not_told(old, tmp_path):
    policy = json.loads((old / PROVENANCE_FILE).read_text())["policy"]
    rehash(old, policy=policy | {"method": "ppo"})
    bundle = upgrade_bundle(old, tmp_path / "new", SCENE)
    assert bundle.provenance["schema_version"] == 2
    assert not bundle.network.estimates
    rehash(old, policy=policy | {"method": "ppo", "auxiliary": True})
    assert upgrade_bundle(old, tmp_path / "taught", SCENE).network.estimates


def test_what_cannot_be_upgraded_is_refused(folder, old, tmp_path):
    with pytest.raises(InputError, match=r"schema_version 2; allowed: a policy, or a bundle of schema_version 1"):
        upgrade_bundle(folder, tmp_path / "new", SCENE)
    with pytest.raises(InputError, match=r"sizes \[\[11\]\]; allowed: a network .* a state of 12 components"):
        with_estimate((old / ONNX_FILE).read_bytes(), old / ONNX_FILE, 12)
    model = onnx.load(old / ONNX_FILE)
    for one in model.graph.initializer:
        one.name = one.name.replace("actor.actor.body", "other")
    for node in model.graph.node:
        for k, name in enumerate(node.input):
            node.input[k] = name.replace("actor.actor.body", "other")
    (old / ONNX_FILE).write_bytes(model.SerializeToString())
    rehash(old)
    with pytest.raises(InputError, match=r"policy\.onnx: got 0 such layers of sizes \[\]; allowed"):
        upgrade_bundle(old, tmp_path / "new", SCENE)
    assert not (tmp_path / "new").exists()
