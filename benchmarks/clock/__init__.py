# SPDX-License-Identifier: MIT
"""Offsets between films and logs of pushes that are rendered with an arm, a table and clutter."""
