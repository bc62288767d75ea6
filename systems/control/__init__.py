# SPDX-License-Identifier: MIT
"""Policies in control of a station or robot, within safety limits."""
