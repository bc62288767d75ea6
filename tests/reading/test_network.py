# SPDX-License-Identifier: MIT
"""Networks that would run without end, take all memory or read other files are refused before anything runs them."""

import time

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from pinwm_drake.errors import InputError
from pinwm_drake.models import policy_path
from pinwm_drake.reading.network import check_network, within

FLOAT = TensorProto.FLOAT


def network(nodes, weights=(), inputs=(("x", [1, 4]),), outputs=(("y", [1, 4]),), opset=18):
    values = [[helper.make_tensor_value_info(name, FLOAT, shape) for name, shape in one] for one in (inputs, outputs)]
    graph = helper.make_graph(list(nodes), "g", *values, list(weights))
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)]).SerializeToString()


def weight(name, array):
    return numpy_helper.from_array(np.asarray(array), name)


def loop():
    one = helper.make_tensor_value_info
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["again"]), helper.make_node("Identity", ["v"], ["w"])],
        "body",
        [one("k", TensorProto.INT64, []), one("go", TensorProto.BOOL, []), one("v", FLOAT, [1, 4])],
        [one("again", TensorProto.BOOL, []), one("w", FLOAT, [1, 4])],
    )
    node = helper.make_node("Loop", ["n", "on", "x"], ["y"], body=body)
    return network([node], [weight("n", np.int64(2**40)), weight("on", np.array(True))])


def outside():
    tensor = weight("w", np.ones((4, 4), np.float32))
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "../../etc/passwd"
    return network([helper.make_node("MatMul", ["x", "w"], ["y"])], [tensor])


def filled():
    nodes = [helper.make_node("ConstantOfShape", ["n"], ["big"]), helper.make_node("ReduceSum", ["big"], ["s"])]
    nodes.append(helper.make_node("Add", ["x", "s"], ["y"]))
    return network(nodes, [weight("n", np.array([10**12]))])


def multiplied():
    # Two rows of 8,000 numbers make a matrix of 64 million, and that to the square 5e11 multiplications.
    names = [("MatMul", ["a", "b"], ["c"]), ("MatMul", ["c", "c"], ["d"]), ("ReduceSum", ["d"], ["s"])]
    nodes = [helper.make_node(*one) for one in (*names, ("Add", ["x", "s"], ["y"]))]
    a, b = np.ones((4000, 1), np.float32), np.ones((1, 4000), np.float32)
    return network(nodes, [weight("a", a), weight("b", b)])


def foreign():
    return network([helper.make_node("Relu", ["x"], ["y"], domain="com.microsoft")])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (loop(), "operator :Loop; allowed: operators of `pinwm export`, no loops"),
        (outside(), "w in another file"),
        (filled(), "numbers, .* at most"),
        (multiplied(), "multiplications; allowed: .* at most"),
        (foreign(), "operator com.microsoft:Relu"),
        (network([helper.make_node("Relu", ["x"], ["y"])], (), (("x", ["n", 4]),), (("y", ["n", 4]),)), "not known"),
        (b"\x0a" * 100, "unreadable"),
    ],
    ids=["loop", "outside", "filled", "multiplied", "foreign", "unknown size", "no network"],
)  # fmt: skip
def test_a_network_that_is_refused(tmp_path, content, words):
    begun = time.monotonic()
    with pytest.raises(InputError, match=words) as caught:
        check_network(content, tmp_path / "policy.onnx")
    assert len(str(caught.value)) <= 300
    assert time.monotonic() - begun < 10.0  # the bar of every refusal, not a speed


@pytest.mark.parametrize("name", ["push_t", "flip_mug"])
def test_networks_that_ship_are_taken(name):
    path = policy_path(name) / "policy.onnx"
    check_network(path.read_bytes(), path)


def test_a_call_that_does_not_end_is_left(tmp_path):
    with pytest.raises(InputError, match=r"no answer within 0\.05 s"):
        within(0.05, lambda: time.sleep(0.5), tmp_path / "policy.onnx")
    assert within(5.0, lambda: 3, tmp_path) == 3
    with pytest.raises(KeyError):
        within(5.0, lambda: {}["x"], tmp_path)
