# SPDX-License-Identifier: MIT
"""Captures made from the formats of others, one format a module."""
