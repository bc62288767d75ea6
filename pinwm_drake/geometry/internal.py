"""Decorators for the kernels of the narrow phase that only other kernels call.

They come without the wrappers through which Python would call them. Unpacking a PieceTable there is more code than
most of them: without it numba compiles the narrow phase in half the time (26 s instead of 55 s on one core).
"""

from numba import njit

from pinwm_drake.jit import geometry_kernel

# As `geometry_kernel`, without wrappers.
internal_kernel = njit(**geometry_kernel_options) if False else None
