# SPDX-License-Identifier: MIT
"""Figures, videos and tables of what the other packages computed. They take arrays, not models."""
