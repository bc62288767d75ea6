"""Bundles of version 1 in the present version: with a scene, and with the policy's estimate of the state.

The weights stay in ONNX. The estimate is there already, as what the network's layers for the action take: it is made an
output. Neither torch nor Drake is imported here.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx

from pinwm_drake.errors import InputError
from pinwm_drake.learning.bundle import (
    CONTRACT_FILE,
    GOLDEN_FILE,
    ONNX_FILE,
    Bundle,
    contract_bytes,
    read_bundle,
    write_bundle,
)
from pinwm_drake.learning.contract import ESTIMATE, SCHEMA_VERSION, make_contract
from pinwm_drake.learning.golden import Golden
from pinwm_drake.learning.runtime import Network
from pinwm_drake.learning.spec import SceneSpec
from pinwm_drake.provenance import timestamp, versions

_FIRST = "actor.actor.body.0.weight"  # of the first layer that takes the state, (width, state_size)
_LIBRARIES = ("onnx", "onnxruntime", "numpy")


def upgrade_bundle(folder: Path, out: Path, scene: SceneSpec, limits: Mapping[str, Any] | None = None) -> Bundle:
    """Writes a bundle of version 1 anew, in the present version; its golden inputs and actions stay as they are.

    The golden estimates are those of onnxruntime. A policy that was not taught the state (`pinwm train --method ppo`)
    gives no estimate.

    Args:
        folder: The bundle of version 1.
        out: Folder of the new one, new or empty.
        scene: The scene that the policy is made for.
        limits: Values of `SafetyLimits` in the place of the bundle's, by name.

    Returns:
        The new bundle, as it was read back.

    Raises:
        InputError: The bundle cannot be read, is of another version, or its network has no such layers; or the folder
            cannot be written.
        ParameterError: A limit is out of range.
    """
    old = read_bundle(folder)
    if (version := old.provenance["schema_version"]) != 1:
        raise InputError(folder, value=f"schema_version {version}", allowed="a policy, or a bundle of schema_version 1")
    spec = dataclasses.replace(old.spec, scene=scene)
    kept = dataclasses.replace(old.limits, **(limits or {}))
    estimate = taught_the_state(old.provenance["policy"])
    golden = Golden.from_bytes((folder / GOLDEN_FILE).read_bytes(), folder / GOLDEN_FILE, spec, estimate=False)
    contract = make_contract(spec, kept, golden.mask_pixels(), estimate=estimate)
    content = (folder / ONNX_FILE).read_bytes()
    if estimate:
        content = with_estimate(content, folder / ONNX_FILE, spec.task.state_size)
        network = Network(content, out / ONNX_FILE, contract)
        told = [network.run_all(*one)[1] for one in zip(golden.images, golden.p_WP, strict=True)]
        golden = dataclasses.replace(golden, estimate=np.array(told))
    files = {ONNX_FILE: content, CONTRACT_FILE: contract_bytes(contract), GOLDEN_FILE: golden.to_bytes()}
    upgraded = {"time": timestamp(), "versions": versions(_LIBRARIES), "from_sha256": old.sha256}
    return write_bundle(out, files, {**old.provenance, "schema_version": SCHEMA_VERSION, "upgraded": upgraded})


def taught_the_state(provenance: Mapping[str, Any]) -> bool:
    """Flag: a policy of images was taught to estimate the state; one that PPO made by the reward alone was not."""
    return provenance.get("method") != "ppo" or bool(provenance.get("auxiliary", False))


def with_estimate(content: bytes, path: Path, state_size: int) -> bytes:
    """The network of a bundle of version 1 with one output more, the estimate (state_size,) of the state.

    Args:
        content: Contents of policy.onnx.
        path: Path that messages name.
        state_size: Number of components of the task's state.

    Raises:
        InputError: It has no layer that takes a state of that size.
    """
    model = onnx.load_from_string(content)
    graph = model.graph
    sizes = [list(one.dims)[1:] for one in graph.initializer if one.name == _FIRST]
    states = [node.input[0] for node in graph.node if len(node.input) > 1 and node.input[1] == _FIRST]
    if len(states) != 1 or sizes != [[state_size]]:
        allowed = f"a network with {_FIRST}, whose input is a state of {state_size} components"
        raise InputError(path, value=f"{len(states)} such layers of sizes {sizes}", allowed=allowed)
    axes = f"{ESTIMATE}_axes"
    graph.initializer.append(onnx.helper.make_tensor(axes, onnx.TensorProto.INT64, [1], [0]))
    graph.node.append(onnx.helper.make_node("Squeeze", [states[0], axes], [ESTIMATE], name=f"node_{ESTIMATE}"))
    graph.output.append(onnx.helper.make_tensor_value_info(ESTIMATE, onnx.TensorProto.FLOAT, [state_size]))
    onnx.checker.check_model(model)
    extended: bytes = model.SerializeToString()
    return extended
