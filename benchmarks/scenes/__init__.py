# SPDX-License-Identifier: MIT
"""Scenes, captures and small worlds that several benchmarks share, in Drake, MuJoCo, Bullet and PIN-WM's code."""
