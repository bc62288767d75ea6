"""Batched rotations, poses and spatial velocities in torch, differentiable throughout."""
