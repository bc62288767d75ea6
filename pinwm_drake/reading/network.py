# SPDX-License-Identifier: MIT
"""Networks in ONNX: known operators alone, all weights inside, and every value of a known and limited size."""

import math
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import onnx
from onnx import shape_inference

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import guarded

_ALLOWED = "a network in ONNX, weights included, that onnxruntime loads"
# Operators without graphs within them, whose outputs have shapes that follow from those of their inputs.
_OPERATORS = """
Abs Add And ArgMax ArgMin Atan Cast Ceil Clip Concat Constant ConstantOfShape Conv Cos Div Elu Equal Erf Exp
Expand Flatten Floor Gather GatherElements GatherND Gelu Gemm Greater GreaterOrEqual GroupNormalization
Identity LayerNormalization LeakyRelu Less LessOrEqual Log MatMul Max Min Mod Mul Neg Not Or Pad Pow
Reciprocal ReduceL2 ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum Relu Reshape Round Selu Shape Sigmoid
Sign Sin Slice Softmax Softplus Split Sqrt Squeeze Sub Tanh Tile Transpose Unsqueeze Where Xor
"""
_MOST_NODES = 10_000


class Limits(NamedTuple):
    """Limits of a network: bytes, numbers in all values, multiplications, and operators besides the usual ones."""

    size: int
    numbers: int
    work: int
    more: frozenset[str] = frozenset()


POLICY = Limits(2**26, 2**25, 10**10)
SEGMENTER = Limits(
    2**30, 2**30, 10**13, frozenset(["AveragePool", "ConvTranspose", "GlobalAveragePool", "MaxPool", "Resize"])
)
_Result = TypeVar("_Result")


def check_network(content: bytes, path: Path, limits: Limits = POLICY) -> None:
    """Check the operators, weights and sizes of a network before anything runs it.

    Args:
        content: Contents of the ONNX file.
        path: Path that messages name.
        limits: What is allowed.

    Raises:
        InputError: An operator is not known, holds a graph or is of another domain, weights lie in other files, or
            the size of a value is not known or too large.
    """
    if len(content) > limits.size:
        raise InputError(path, value=f"{len(content)} bytes", allowed=f"{limits.size} bytes at most")
    with guarded(path, _ALLOWED):
        model = onnx.load_from_string(content)
        graph, known = model.graph, limits.more.union(_OPERATORS.split())
        if len(model.functions) or len(graph.sparse_initializer) or len(graph.node) > _MOST_NODES:
            found = f"{len(graph.node)} nodes, {len(model.functions)} functions"
            raise InputError(path, value=found, allowed=f"{_MOST_NODES} nodes at most, no functions")
        for node in graph.node:
            inner = any(one.HasField("g") or one.graphs or one.ref_attr_name for one in node.attribute)
            if node.domain not in ("", "ai.onnx") or node.op_type not in known or inner:
                value = f"the operator {node.domain}:{node.op_type}"
                raise InputError(path, value=value, allowed="operators of `pinwm export`, no loops and no graphs")
        constants = [one.t for node in graph.node for one in node.attribute if one.HasField("t")]
        for tensor in (*graph.initializer, *constants):
            if tensor.external_data or tensor.data_location:
                raise InputError(path, value=f"{tensor.name} in another file", allowed="weights inside of the network")
            if any(length < 0 for length in tensor.dims) or math.prod(tensor.dims) > limits.size:
                raise InputError(path, value=f"{tensor.name} of {list(tensor.dims)}", allowed="sizes that make sense")
        del graph.value_info[:]  # what it says of itself does not count
        _check_sizes(shape_inference.infer_shapes(model, strict_mode=True, data_prop=True).graph, path, limits)


def _check_sizes(graph: Any, path: Path, limits: Limits) -> None:
    """Raise InputError where the size of a value is not known or too large, or a layer is too much work."""
    shapes = {one.name: list(one.dims) for one in graph.initializer}
    for value in (*graph.input, *graph.value_info, *graph.output):
        lengths = value.type.tensor_type.shape.dim if value.type.tensor_type.HasField("shape") else None
        if lengths is None or not all(one.HasField("dim_value") and one.dim_value >= 0 for one in lengths):
            raise InputError(path, value=f"{value.name} of a shape that is not known", allowed="shapes that are fixed")
        shapes[value.name] = [one.dim_value for one in lengths]
    numbers, work = sum(math.prod(shape) for shape in shapes.values()), 0
    for node in graph.node:
        unknown = [name for name in (*node.input, *node.output) if name and name not in shapes]
        if unknown:
            raise InputError(path, value=f"{unknown[0]} of a size that is not known", allowed="shapes that are fixed")
        terms = 1  # that one number is the sum of
        if node.op_type in ("Conv", "ConvTranspose"):
            terms = math.prod(shapes[node.input[1]][1:])
        elif node.op_type in ("Gemm", "MatMul"):
            terms = max(shapes[node.input[0]], default=1)
        work += terms * sum(math.prod(shapes[name]) for name in node.output if name)
    if numbers > limits.numbers or work > limits.work:
        value = f"{numbers} numbers, {work} multiplications"
        raise InputError(path, value=value, allowed=f"{limits.numbers} and {limits.work} at most")


def within(seconds: float, call: Callable[[], _Result], path: Path) -> _Result:
    """Return what a call returns, and go on without it where it takes too long.

    Args:
        seconds: Time limit; a call that does not end is left to a thread that ends with the process.
        call: The call.
        path: Path that messages name.

    Raises:
        InputError: It took longer.
        Exception: What the call raises.
    """
    found: list[_Result] = []
    raised: list[BaseException] = []

    def run() -> None:
        try:
            found.append(call())
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(seconds)
    if thread.is_alive():
        raise InputError(path, value=f"no answer within {seconds:g} s", allowed="an answer in milliseconds")
    if raised:
        raise raised[0]
    return found[0]
