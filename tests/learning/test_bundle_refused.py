# SPDX-License-Identifier: MIT
import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from pinwm_drake.learning.bundle import CONTRACT_FILE, HASHED, ONNX_FILE, PROVENANCE_FILE, read_bundle, write_bundle
from pinwm_drake.learning.policy import write_policy
from tests.learning.bundles import image_spec, refused, rehash, untrained_policy

FILES = (*HASHED, PROVENANCE_FILE)


def rewrite(path: Path, change: Callable[[dict], object]) -> None:
    """Changes a YAML or JSON document."""
    text = path.read_text()
    document = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
    change(document)
    path.write_text(json.dumps(document) if path.suffix == ".json" else yaml.safe_dump(document))


@pytest.mark.parametrize("name", FILES)
def test_a_missing_file(folder, name):
    (folder / name).unlink()
    assert refused(folder, name) == ": no such file; allowed: a bundle that `pinwm export` wrote"


@pytest.mark.parametrize("name", FILES)
def test_a_folder_in_place_of_a_file(folder, name):
    (folder / name).unlink()
    (folder / name).mkdir()
    assert refused(folder, name) == ": got a folder; allowed: a file that can be read"


@pytest.mark.parametrize("name", HASHED)
def test_a_changed_byte(folder, name):
    content = bytearray((folder / name).read_bytes())
    content[len(content) // 2] ^= 1
    (folder / name).write_bytes(content)
    told = json.loads((folder / PROVENANCE_FILE).read_text())["files"][name]
    message = refused(folder, name)
    assert re.match(
        rf": got other contents, {len(content)} bytes with SHA-256 [0-9a-f]{{12}}; allowed: {told[:12]},", message
    )


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_file_that_is_cut_off(folder, name, share):
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[: int(share * len(content))])
    message = refused(folder, name)
    assert message.endswith("allowed: JSON") if name == PROVENANCE_FILE else message.startswith(": got other contents")


def test_a_changed_provenance(folder):
    rewrite(folder / PROVENANCE_FILE, lambda document: document["policy"].update(seed=1))
    assert refused(folder, PROVENANCE_FILE).startswith(": got other contents, with SHA-256")


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_a_number_of_the_provenance_that_is_not_finite(folder, number):
    path = folder / PROVENANCE_FILE
    rehash(folder, loss=123.5)
    path.write_text(path.read_text().replace("123.5", number))
    assert refused(folder, PROVENANCE_FILE) == f": got {number}; allowed: finite numbers"


def test_a_policy_whose_provenance_has_a_number_that_is_not_finite_is_exported(folder, tmp_path):
    files = {name: (folder / name).read_bytes() for name in HASHED}
    written = write_bundle(tmp_path / "written", files, read_bundle(folder).provenance | {"loss": float("nan")})
    assert written.provenance["loss"] == "NaN"


def test_an_extra_file(folder):
    (folder / ".hidden").write_text("left alone: file managers leave such")
    read_bundle(folder)
    (folder / "policy.onnx.data").write_bytes(b"weights")
    assert refused(folder, "policy.onnx.data").startswith(
        ": got a file that is not of the bundle; allowed: policy.onnx"
    )


@pytest.mark.parametrize("version", [3, "1", None, True, 1])
@pytest.mark.parametrize("name", [PROVENANCE_FILE, CONTRACT_FILE])
def test_another_version(folder, name, version):
    rewrite(folder / name, lambda document: document.update(schema_version=version))
    if name == CONTRACT_FILE:
        rehash(folder)
    anew = "; export the bundle anew with the release 0.1" if version == 1 and version is not True else ""
    assert refused(folder, name) == f": got schema_version {version}; allowed: schema_version 2{anew}"


def test_documents_that_are_none(folder):
    (folder / PROVENANCE_FILE).write_text("[1]")
    assert refused(folder, PROVENANCE_FILE).startswith(": got a list; allowed: a bundle")
    (folder / PROVENANCE_FILE).write_bytes(b"\xff\xfe")
    assert refused(folder, PROVENANCE_FILE) == ": got a byte that is not text at 0; allowed: text in UTF-8"


@pytest.mark.parametrize("content", [b"a: [1", b"\xff\xfe", b"- 1"])
def test_a_contract_that_is_none(folder, content):
    (folder / CONTRACT_FILE).write_bytes(content)
    rehash(folder)
    assert refused(folder, CONTRACT_FILE).endswith(("allowed: YAML", "text in UTF-8", "that `pinwm export` wrote"))


def test_hashes_of_other_files(folder):
    rehash(folder, files={ONNX_FILE: "0"})
    message = refused(folder, PROVENANCE_FILE)
    assert message == ": got files: ['policy.onnx']; allowed: SHA-256 of policy.onnx, contract.yaml, golden.npz"
    rehash(folder, files=None)
    assert refused(folder, PROVENANCE_FILE).startswith(": got files: None;")


def put(document: dict, name: str, value: object) -> None:
    """Sets an entry such as inputs.0.shape."""
    *way, last = [int(part) if part.isdigit() else part for part in name.split(".")]
    for part in way:
        document = document[part]
    document[last] = value


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("inputs.0.shape", [32, 32, 3], "inputs[0].shape[0]: 32; allowed: 16"),
        ("inputs.0.dtype", "float32", "inputs[0].dtype: float32; allowed: uint8"),
        ("inputs.0.camera.fx", 25.0, "inputs[0].camera.fx: 25.0; allowed: 24.0"),
        ("inputs.1.unit", "mm", "inputs[1].unit: mm; allowed: m"),
        ("outputs.0.rate", 20.0, "outputs[0].rate: 20.0; allowed: 10.0"),
        ("onnx.opset", 17, "onnx.opset: 17; allowed: 18"),
        ("comment", "mine", "comment: mine; allowed: no entry"),
        ("outputs", [], "outputs: []; allowed: [{"),
        ("spec.max_translation", 0.2, "outputs[0].max_translation: 0.02; allowed: 0.2"),
        ("spec.horizon", 0.2, "inputs[0].rate: 10.0; allowed: 5.0"),
        ("spec.horizon", -1.0, "horizon: got -1.0; allowed: more than 0"),
        ("spec.task.goal", None, "task.goal: got None; allowed: 3 numbers"),
        ("spec.observes", "state", "spec.observes: state; allowed: rgb"),
        ("outputs.1.unit", "m", "outputs[1].unit: m; allowed: ['0.1 m', "),
        ("inputs.0.max_latency", 0.3, "inputs[0].max_latency: 0.3; allowed: 0.2"),
        ("inputs.1.period", 0.2, "inputs[1].period: 0.2; allowed: 0.1"),
        ("mask.pixels.0", 1, "mask.pixels[0]: 1; allowed: 40, which follows from golden.npz"),
        ("mask", None, "mask: None; allowed: {'pixels': [40, 40], "),
        ("spec.scene", {}, "scene: got []; allowed: the keys object, pusher, floor_height"),
        ("spec.scene.object.mesh_sha256", "x", "scene.object.mesh_sha256: got 'x'; allowed: a SHA-256, "),
        ("spec.scene.object.size.1", 0.0, "scene.object.size: got (0.1, 0.0, 0.05); allowed: more than 0 m"),
        ("spec.scene.pusher.shape", "cone", "scene.pusher.shape: got 'cone'; allowed: sphere, capsule, cyl"),
        ("spec.scene.pusher.radius", 0.0, "scene.pusher: got radius 0.0 m, length 0.04 m; allowed: more than 0"),
        ("spec.scene.pusher.shape", "mesh", "scene.pusher.mesh_sha256: got None; allowed: a SHA-256, "),
        ("spec.scene.floor_height", "low", "scene.floor_height: got 'low'; allowed: a finite number"),
        ("safety.max_speed", float("inf"), "max_speed: got inf; allowed: a finite number, more than 0"),
        ("safety", {}, "limits: got []; allowed: the keys box_low"),
        ("safety", None, "limits: got None; allowed: the keys box_low"),
    ],
)
def test_a_contract_that_contradicts_itself(folder, name, value, message):
    rewrite(folder / CONTRACT_FILE, lambda document: put(document, name, value))
    rehash(folder)
    assert refused(folder, CONTRACT_FILE).startswith(f": got {message}")


def test_a_contract_without_an_entry(folder):
    rewrite(folder / CONTRACT_FILE, lambda document: document["inputs"][1].pop("frame"))
    rehash(folder)
    assert refused(folder, CONTRACT_FILE).startswith(": got inputs[1].frame: no entry; allowed: W")
    rewrite(folder / CONTRACT_FILE, lambda document: document.pop("safety"))
    rehash(folder)
    assert refused(folder, CONTRACT_FILE).startswith(": got limits: got None")


def test_a_word_of_a_contract_that_is_nan(folder):
    rewrite(folder / CONTRACT_FILE, lambda document: document["inputs"][0].update(meaning=float("nan")))
    rehash(folder)
    assert refused(folder, CONTRACT_FILE) == ": got NaN or an infinite number; allowed: finite numbers"


def test_words_of_a_contract_may_be_other_ones(folder):
    rewrite(folder / CONTRACT_FILE, lambda document: document["inputs"][0].update(meaning="of a later version"))
    rewrite(folder / CONTRACT_FILE, lambda document: document.update(notes={}))
    rehash(folder)
    read_bundle(folder)


def test_no_bundle_at_all(tmp_path):
    as_written = "; allowed: a bundle that `pinwm export` wrote"
    assert refused(tmp_path / "none", None) == f": got none there{as_written}"
    assert refused(tmp_path, None) == f": got none there{as_written}"
    (tmp_path / "file").write_text("")
    assert refused(tmp_path / "file", None) == f": got none there{as_written}"
    write_policy(tmp_path / "policy", untrained_policy(image_spec(16, 1)))
    assert refused(tmp_path / "policy", None) == f": got a policy{as_written}"
