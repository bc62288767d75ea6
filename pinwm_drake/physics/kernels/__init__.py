"""Numba kernels of the rigid-body step: contacts, LCP, step, adjoint, rollouts over worlds and threads."""
