# SPDX-License-Identifier: MIT
"""Policies: specification, training, evaluation and export. The worlds to act in are passed in."""
