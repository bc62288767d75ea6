"""Networks and their optimizers as plain arrays, for checkpoints without pickles."""

from collections.abc import Mapping

import numpy as np
import torch
from torch import nn

from pinwm_drake.errors import ParameterError


def pack(network: nn.Module, optimizer: torch.optim.Optimizer) -> dict[str, np.ndarray]:
    """All that both hold, copied: `net.NAME` and `adam.NUMBER.NAME`."""
    arrays = {f"net.{name}": value.detach().cpu().numpy().copy() for name, value in network.state_dict().items()}
    for number, values in optimizer.state_dict()["state"].items():
        for name, value in values.items():
            arrays[f"adam.{number}.{name}"] = torch.as_tensor(value).cpu().numpy().copy()
    return arrays


def unpack(arrays: Mapping[str, np.ndarray], network: nn.Module, optimizer: torch.optim.Optimizer) -> None:
    """Puts what `pack` gave back.

    Raises:
        ParameterError: They are not of this network.
    """
    net = {name.removeprefix("net."): torch.from_numpy(a) for name, a in arrays.items() if name.startswith("net.")}
    state: dict[int, dict[str, torch.Tensor]] = {}
    for name, array in arrays.items():
        if name.startswith("adam."):
            _, number, key = name.split(".")
            state.setdefault(int(number), {})[key] = torch.from_numpy(array)
    try:
        network.load_state_dict(net)
        optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})
    except (RuntimeError, ValueError, KeyError) as error:
        raise ParameterError(
            f"checkpoint: {' '.join(str(error).split())[:300]}; allowed: that of this network"
        ) from error
