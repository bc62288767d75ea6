# SPDX-License-Identifier: MIT
"""Diffusion policy: sequences of actions are drawn by taking noise away, given images and the pusher's position."""
