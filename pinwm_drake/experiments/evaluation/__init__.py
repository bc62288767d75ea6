# SPDX-License-Identifier: MIT
"""Evaluation of policies in an engine: episodes, stored results, tables."""
