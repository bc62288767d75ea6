# SPDX-License-Identifier: MIT
"""Output of processes that tests start."""

from pinwm_drake.kernel_cache import COMPILING


def without_note(errors: str) -> str:
    """Error output without the line that kernels are compiled, which is there in a new checkout."""
    return errors.replace(f"{COMPILING}\n", "")
