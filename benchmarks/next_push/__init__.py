# SPDX-License-Identifier: MIT
"""Benchmark of twins that predict the next push: captures of engines that are not ours, and what twins make of them."""
