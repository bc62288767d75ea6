# SPDX-License-Identifier: MIT
"""Recipes of the tasks that ship."""
