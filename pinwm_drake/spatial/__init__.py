# SPDX-License-Identifier: MIT
"""Batched rotations, poses and spatial velocities in torch, differentiable throughout."""
