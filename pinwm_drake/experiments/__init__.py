# SPDX-License-Identifier: MIT
"""Alignment, identification, training, evaluation and export as library calls, with results on disk."""
