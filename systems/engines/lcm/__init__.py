# SPDX-License-Identifier: MIT
"""A robot behind LCM messages as an engine."""
