# SPDX-License-Identifier: MIT
"""Numba kernels of the rigid-body step: contacts, their solution, step, adjoint, rollouts over worlds and threads."""
