# SPDX-License-Identifier: MIT
"""Meshcat views of a station."""
