# SPDX-License-Identifier: MIT
import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from pinwm_drake.errors import InputError, ParameterError, StateError
from pinwm_drake.learning.bundle import Bundle, is_bundle, read_bundle
from pinwm_drake.learning.golden import Golden, object_pixels
from pinwm_drake.learning.policy import Policy, write_policy
from pinwm_drake.learning.spec import PolicySpec
from tests.learning.bundles import (
    HIGH,
    LONGEST,
    LOW,
    SCENE,
    exported,
    image_spec,
    pictures,
    untrained_policy,
)

ROOT = Path(__file__).resolve().parents[2]
SPEC = image_spec(scene=SCENE)


@pytest.fixture(scope="module")
def policy() -> Policy:
    return untrained_policy(SPEC)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, policy) -> Path:
    return exported(tmp_path_factory.mktemp("bundle") / "bundle", policy)


@pytest.fixture(scope="module")
def bundle(folder) -> Bundle:
    return read_bundle(folder)


def test_predict_answers_as_the_policy_does_of_one_and_of_many(policy, bundle):
    images, _ = pictures(SPEC, 8)
    pusher = np.random.default_rng(5).uniform(-1, 1, (8, 2)).astype(np.float32)
    expected, _ = policy.predict({"image": images, "pusher": pusher})
    # The bundle's are shortened already; an environment does that with those of the policy.
    expected /= np.maximum(np.linalg.norm(expected, axis=1, keepdims=True), 1)
    found, state = bundle.predict({"image": images, "pusher": pusher, "state": np.zeros((8, 11))})
    assert (found.dtype, state) == (np.float32, None)
    assert found == pytest.approx(expected, abs=1e-5)
    one, _ = bundle.predict({"image": images[2], "pusher": pusher[2]}, None, np.array([True]), True)
    assert np.array_equal(one, found[2])
    none, _ = bundle.predict({"image": images[:0], "pusher": pusher[:0]})
    assert none.shape == (0, 2)


def test_a_step_tells_the_policys_own_estimate_of_the_state(policy, bundle):
    images, p_WP = pictures(SPEC, 5)
    pusher = np.clip((p_WP - LOW) / np.subtract(HIGH, LOW) * 2 - 1, -1, 1).astype(np.float32)
    with torch.inference_mode():
        expected = policy.actor.state(torch.from_numpy(images), torch.from_numpy(pusher)).numpy()
    assert np.ptp(expected, axis=0).min() > 0  # each component of the state tells the images apart
    for image, p, told in zip(images, p_WP, expected, strict=True):
        d_W, estimate = bundle.step(image, p)
        assert np.array_equal(d_W, bundle.act(image, p))
        assert (estimate.shape, estimate.dtype) == ((11,), float)
        assert estimate == pytest.approx(told, abs=1e-5)
    assert bundle.network.estimates


def test_the_scene_is_read_as_it_was_written(bundle):
    assert bundle.spec.scene == SCENE
    document = bundle.spec.to_document()
    assert PolicySpec.from_document(document) == bundle.spec
    del document["scene"]  # of a policy from before there was one
    assert PolicySpec.from_document(document) == dataclasses.replace(bundle.spec, scene=None)


def test_the_numbers_of_pixels_are_those_of_the_pictures_alone(bundle):
    # Rectangles of a third by half of the picture; neither the white golden images nor those of blocks count.
    assert bundle.mask_pixels == (10 * 16, 10 * 16)
    assert bundle.contract["mask"] == {"pixels": [160, 160], "hidden": [255, 255, 255]}


def test_a_bundle_is_found_by_a_text(folder, bundle):
    assert read_bundle(str(folder)).sha256 == bundle.sha256
    assert read_bundle("push_t").spec.scene.object.name == "t_block"
    with pytest.raises(InputError, match=r"^nowhere: .*allowed: a folder, or one of flip_mug, push_t$"):
        read_bundle("nowhere")


def test_a_position_beyond_the_box_counts_as_at_its_wall(bundle):
    image, middle = pictures(SPEC, 1)[0][0], 0.5 * np.add(LOW, HIGH)
    far, wall = np.array([HIGH[0] + 1, middle[1]]), np.array([HIGH[0], middle[1]])
    assert np.array_equal(bundle.act(image, far), bundle.act(image, wall))
    assert not np.array_equal(bundle.act(image, middle), bundle.act(image, wall))
    assert np.linalg.norm(bundle.act(image, far)) <= LONGEST * (1 + 1e-6)


def test_a_position_that_is_no_number_is_not_hidden(bundle):
    image = pictures(SPEC, 1)[0][0]
    assert np.isnan(bundle.act(image, np.array([np.nan, 0.0]))).all()
    assert np.isfinite(bundle.act(image, np.zeros(2))).all()


def test_images_may_lie_in_memory_as_they_like(bundle):
    image = pictures(SPEC, 1)[0][0]
    turned = np.asfortranarray(image)
    assert not turned.flags.c_contiguous
    assert np.array_equal(bundle.act(turned, np.zeros(2)), bundle.act(image, np.zeros(2)))


def test_wrong_shapes_are_named(bundle):
    image = pictures(SPEC, 1)[0][0]
    for wrong in (image[..., :3], image[None], image.astype(np.float32), image[:-1]):
        with pytest.raises(StateError, match=r"^image: got .*; allowed: uint8 \(32, 32, 6\)$"):
            bundle.act(wrong, np.zeros(2))
    with pytest.raises(StateError, match=r"^p_WP: got .*\(3,\); allowed: \(2,\), along the axes of the task, m$"):
        bundle.act(image, np.zeros(3))
    with pytest.raises(ParameterError, match=r"^observation: got \['image'\]; allowed: a dict with image and pusher$"):
        bundle.predict({"image": image})
    with pytest.raises(ParameterError, match=r"^observation: got ndarray; allowed"):
        bundle.predict(np.zeros(11))


def test_one_thread_is_used(bundle):
    session = bundle.network._session
    options = session.get_session_options()
    assert (options.intra_op_num_threads, options.inter_op_num_threads) == (1, 1)
    assert session.get_providers() == ["CPUExecutionProvider"]


def test_bundles_are_told_from_each_other_and_from_policies(bundle, folder, policy, tmp_path):
    other = read_bundle(exported(tmp_path / "other", untrained_policy(SPEC, gain=-1.0)))
    assert other.sha256 != bundle.sha256 == read_bundle(folder).sha256
    write_policy(tmp_path / "policy", policy)
    assert [is_bundle(path) for path in (folder, tmp_path / "policy", tmp_path / "nothing")] == [True, False, False]


def test_a_bundle_is_run_without_torch_sb3_and_drake(folder, bundle):
    code = f"""
import sys
from pathlib import Path
import numpy as np
from pinwm_drake.learning.bundle import read_bundle
bundle = read_bundle(Path({str(folder)!r}))
image = np.full(bundle.spec.image_shape, 200, np.uint8)
print(*bundle.act(image, np.zeros(2)), bundle.predict({{"image": image, "pusher": np.zeros(2)}})[0].shape)
heavy = ["torch", "stable_baselines3", "gymnasium", "pydrake", "onnxscript", "numba", "cv2", "matplotlib"]
print([name for name in heavy if name in sys.modules], "onnxruntime" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    answer, loaded = done.stdout.splitlines()
    assert loaded == "[] True"
    d_W = bundle.act(np.full(SPEC.image_shape, 200, np.uint8), np.zeros(2))
    assert answer == f"{d_W[0]} {d_W[1]} (2,)"
    assert done.stderr == ""


def test_onnxruntime_tells_nobody_what_it_runs(tmp_path):
    # Its telemetry begins with a file of the session in the folder for temporary files.
    environment = {name: value for name, value in os.environ.items() if name not in ("ORT_DISABLE_TELEMETRY", "CI")}
    environment["TMPDIR"] = str(tmp_path)

    code = "import sys, pinwm_drake.learning.bundle; assert 'onnxruntime' in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    assert list(tmp_path.iterdir()) == []


def test_numbers_of_pixels_that_no_picture_tells_are_any():
    white, shown = np.full((1, 8, 8, 6), 255, np.uint8), np.full((1, 8, 8, 6), 255, np.uint8)
    shown[0, :2, :3, :3], shown[0, 0, 0, 3:] = 7, (255, 254, 255)  # six pixels of the first image, one of the second
    numbers = np.zeros((2, 2), np.float32)
    assert Golden(white, numbers[:1], numbers[:1]).mask_pixels() == (0, 64)
    assert Golden(np.zeros_like(white), numbers[:1], numbers[:1]).mask_pixels() == (0, 64)
    assert object_pixels(shown).tolist() == [[6, 1]]
    assert Golden(np.concatenate([white, shown]), numbers, numbers).mask_pixels() == (1, 6)
