"""Check of the last axis, which every spatial function makes of its arguments."""

import torch

from pinwm_drake.errors import StateError


def require_last_axis(array: torch.Tensor, size: int, name: str) -> None:
    """Checks the length of the last axis.

    Args:
        array: Any tensor.
        size: The length its last axis has to have.
        name: Name of the tensor in the message.

    Raises:
        StateError: When the last axis has another length, or there is none.
    """
    if array.ndim == 0 or array.shape[-1] != size:
        raise StateError(f"{name}: got shape {tuple(array.shape)}; allowed: (..., {size})")
