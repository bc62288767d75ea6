# SPDX-License-Identifier: MIT
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.learning.bundle import GOLDEN_FILE, ONNX_FILE, read_bundle
from tests.learning.bundles import refused, rehash


def rewrite_arrays(path: Path, change: Callable[[dict], object]) -> None:
    with np.load(path) as file:
        arrays = dict(file)
    change(arrays)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    path.write_bytes(buffer.getvalue())


@pytest.mark.parametrize("content", [b"", b"no network"])
def test_no_network(folder, content):
    (folder / ONNX_FILE).write_bytes(content)
    rehash(folder)
    assert refused(folder, ONNX_FILE).startswith(": got unreadable contents (")


def test_a_network_that_is_cut_off_and_hashed_anew(folder, capfd):
    content = (folder / ONNX_FILE).read_bytes()
    (folder / ONNX_FILE).write_bytes(content[: len(content) // 2])
    rehash(folder)
    assert refused(folder, ONNX_FILE).startswith(": got unreadable contents (")
    assert capfd.readouterr() == ("", "")


def constant_network(shape: list[int], kind: int = onnx.TensorProto.UINT8, output: str = "pusher_translation") -> bytes:
    """A network that answers with the position it is given, and with an estimate of zeros."""
    make = onnx.helper.make_tensor_value_info
    zeros = onnx.helper.make_tensor("zeros", onnx.TensorProto.FLOAT, [11], np.zeros(11))
    graph = onnx.helper.make_graph(
        [
            onnx.helper.make_node("Identity", ["pusher_position"], [output]),
            onnx.helper.make_node("Constant", [], ["state_estimate"], value=zeros),
        ],
        "constant",
        [make("image", kind, shape), make("pusher_position", onnx.TensorProto.FLOAT, [2])],
        [make(output, onnx.TensorProto.FLOAT, [2]), make("state_estimate", onnx.TensorProto.FLOAT, [11])],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)])
    model.ir_version = 10
    return model.SerializeToString()


def test_a_network_of_other_inputs_and_outputs(folder):
    as_told = "; allowed: image uint8 [16, 16, 3], pusher_position float32 [2], as the contract says"
    for content, message in (
        (constant_network([32, 32, 3]), f"inputs image uint8 [32, 32, 3], pusher_position float32 [2]{as_told}"),
        (constant_network([16, 16, 9]), f"inputs image uint8 [16, 16, 9], pusher_position float32 [2]{as_told}"),
        (
            constant_network([16, 16, 3], onnx.TensorProto.FLOAT),
            f"inputs image float32 [16, 16, 3], pusher_position float32 [2]{as_told}",
        ),
        (
            constant_network([16, 16, 3], output="action"),
            "outputs action float32 [2], state_estimate float32 [11]; allowed: pusher_translation float32 [2], "
            "state_estimate float32 [11], as the contract says",
        ),
    ):
        (folder / ONNX_FILE).write_bytes(content)
        rehash(folder)
        assert refused(folder, ONNX_FILE) == f": got {message}"


def test_a_network_whose_parts_do_not_fit_each_other(folder):
    model = onnx.load_from_string((folder / ONNX_FILE).read_bytes())
    convolutions = [node for node in model.graph.node if node.op_type == "Conv"]
    convolutions[-1].input[0] = convolutions[0].output[0]
    (folder / ONNX_FILE).write_bytes(model.SerializeToString())
    rehash(folder)
    message = refused(folder, ONNX_FILE)
    assert message.startswith(": got a network that does not run ([ONNXRuntimeError]")
    assert message.endswith("; allowed: one whose parts fit each other")


def test_another_network_of_the_same_inputs(folder):
    (folder / ONNX_FILE).write_bytes(constant_network([16, 16, 3]))
    rehash(folder)
    with pytest.raises(InputError, match=r"golden\.npz, row 1: got .* m, where policy\.onnx answers .* m off; allowed"):
        read_bundle(folder)


@pytest.mark.parametrize(("by", "good"), [(0.9e-5, True), (1.1e-5, False), (np.nan, False), (np.inf, False)])
def test_golden_answers_that_are_off(folder, by, good):
    def change(arrays: dict) -> None:
        arrays["pusher_translation"][3, 1] += np.float32(by)

    rewrite_arrays(folder / GOLDEN_FILE, change)
    rehash(folder)
    if good:
        read_bundle(folder)
    else:
        with pytest.raises(InputError, match=r"golden\.npz, row 4: got .*; allowed: 1e-05 m between the two$"):
            read_bundle(folder)


@pytest.mark.parametrize(("by", "good"), [(0.9e-4, True), (1.2e-4, False), (np.nan, False)])
def test_golden_estimates_that_are_off(folder, by, good):
    def change(arrays: dict) -> None:
        row = arrays["state_estimate"][2]
        row[3] += np.float32(by) * max(1.0, abs(row[3]))

    rewrite_arrays(folder / GOLDEN_FILE, change)
    rehash(folder)
    if good:
        read_bundle(folder)
    else:
        with pytest.raises(InputError, match=r"golden\.npz, row 3: got state_estimate .* off; allowed: 0\.0001 "):
            read_bundle(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda arrays: arrays.pop("image"),
            "arrays ['pusher_position', 'pusher_translation', 'state_estimate']; allowed: arrays ['image'",
        ),
        (
            lambda arrays: arrays.pop("state_estimate"),
            "arrays ['image', 'pusher_position', 'pusher_translation']; allowed: arrays ['image', 'pusher_position', "
            "'pusher_translation', 'state_estimate']",
        ),
        (lambda arrays: arrays.update(extra=np.zeros(1)), "arrays ['extra', 'image', 'pusher_position'"),
        (
            lambda arrays: arrays.update(image=arrays["image"][:, :8]),
            "image of uint8 (10, 8, 16, 3); allowed: uint8 (n, 16,",
        ),
        (lambda arrays: arrays.update(image=np.zeros((), np.uint8)), "image of uint8 (); allowed: uint8 (n, 16,"),
        (
            lambda arrays: arrays.update(pusher_position=arrays["pusher_position"][1:]),
            "pusher_position of float32 (9, 2); allowed: float32 (n, 2)",
        ),
        (
            lambda arrays: arrays.update(pusher_translation=arrays["pusher_translation"].astype(float)),
            "pusher_translation of float64 (10, 2); allowed: float32 (n, 2)",
        ),
        (
            lambda arrays: arrays.update({name: array[:0] for name, array in arrays.items()}),
            "image of uint8 (0, 16, 16, 3); allowed: uint8 (n, 16, 16, 3), n of 1 or more",
        ),
    ],
)
def test_golden_samples_of_other_shapes(folder, change, message):
    rewrite_arrays(folder / GOLDEN_FILE, change)
    rehash(folder)
    assert refused(folder, GOLDEN_FILE).startswith(f": got {message}")


def test_golden_samples_that_are_none(folder):
    for content in (b"", b"no archive", (folder / GOLDEN_FILE).read_bytes()[:-30]):
        (folder / GOLDEN_FILE).write_bytes(content)
        rehash(folder)
        assert refused(folder, GOLDEN_FILE).startswith(": got unreadable contents")
    objects = io.BytesIO()
    np.savez(objects, image=np.array([{}], object), pusher_position=np.zeros(1), pusher_translation=np.zeros(1))
    (folder / GOLDEN_FILE).write_bytes(objects.getvalue())
    rehash(folder)
    assert "allowed: flags, numbers or text, no pickles" in refused(folder, GOLDEN_FILE)
