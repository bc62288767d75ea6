# SPDX-License-Identifier: MIT
"""Pairwise narrow phase: features of contact between convex pieces."""
