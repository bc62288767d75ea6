# SPDX-License-Identifier: MIT
"""Networks and their optimizers as plain arrays, for files without pickles."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import nn

from pinwm_drake.errors import ParameterError, require


def devices() -> tuple[str, ...]:
    """Devices that networks can be trained on here, the quickest one last."""
    return ("cpu", "cuda") if torch.cuda.is_available() else ("cpu",)


def require_device(option: str, name: str) -> None:
    """Check that a device is one of those here; "cuda:0" is one where "cuda" is.

    Args:
        option: Option that names it, as its user writes it.
        name: Name of the device.

    Raises:
        ParameterError: It is none of them.
    """
    require(option, name, name.partition(":")[0] in devices(), f"{', '.join(devices())}, as torch sees no other")


def has_bfloat16(device: str = "cpu") -> bool:
    """Flag: a device is a CPU with instructions for bfloat16, in which it convolves twice as fast as in 32 bits.

    Without them bfloat16 is slower than 32 bits are.
    """
    supported: bool = torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
    return device == "cpu" and supported


def device_of(network: nn.Module) -> torch.device:
    """Device that a network's numbers are on, all of them."""
    return next(network.parameters()).device


def weights(network: nn.Module) -> dict[str, np.ndarray]:
    """All numbers of a network by name, copied."""
    return {name: value.detach().cpu().numpy().copy() for name, value in network.state_dict().items()}


def set_weights(network: nn.Module, arrays: Mapping[str, np.ndarray]) -> None:
    """Restores a network from the arrays of `weights`.

    Raises:
        ParameterError: They are not of this network.
    """
    wrong = next(
        (one for one, value in arrays.items() if value.dtype.kind not in "biuf" or not np.isfinite(value).all()), None
    )
    if wrong is not None:
        raise ParameterError(f"weights: got {wrong} with a number that is not finite; allowed: finite numbers")
    try:
        network.load_state_dict({name: torch.from_numpy(value) for name, value in arrays.items()})
    except (RuntimeError, TypeError) as error:
        raise _not_of_this(error) from error


def pack(network: nn.Module, optimizer: torch.optim.Optimizer) -> dict[str, np.ndarray]:
    """All numbers of a network and its optimizer, copied: `net.NAME` and `adam.NUMBER.NAME`."""
    arrays = {f"net.{name}": value for name, value in weights(network).items()}
    for number, values in optimizer.state_dict()["state"].items():
        for name, value in values.items():
            arrays[f"adam.{number}.{name}"] = torch.as_tensor(value).cpu().numpy().copy()
    return arrays


def unpack(arrays: Mapping[str, np.ndarray], network: nn.Module, optimizer: torch.optim.Optimizer) -> None:
    """Restores a network and its optimizer from the arrays of `pack`.

    Raises:
        ParameterError: They are not of this network.
    """
    set_weights(network, {name.removeprefix("net."): a for name, a in arrays.items() if name.startswith("net.")})
    state: dict[int, dict[str, torch.Tensor]] = {}
    for name, array in arrays.items():
        if name.startswith("adam."):
            _, number, key = name.split(".")
            if not number.isdigit() or array.dtype.kind not in "iuf":
                raise ParameterError(f"weights: got {name} of {array.dtype}; allowed: those of this network")
            state.setdefault(int(number), {})[key] = torch.from_numpy(array)
    numbers = [one for group in optimizer.param_groups for one in group["params"]]
    for index, tensors in state.items():
        shape = numbers[index].shape if index < len(numbers) else None
        for key, value in tensors.items():
            if not bool(value.isfinite().all()) or value.shape not in (shape, ()):
                raise ParameterError(
                    f"weights: got adam.{number}.{key} of {tuple(value.shape)}; allowed: finite {shape}"
                )
    try:
        optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})
    except (ValueError, KeyError) as error:
        raise _not_of_this(error) from error


def _not_of_this(error: Exception) -> ParameterError:
    return ParameterError(f"weights: {' '.join(str(error).split())[:300]}; allowed: those of this network")
