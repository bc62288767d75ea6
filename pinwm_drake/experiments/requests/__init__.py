# SPDX-License-Identifier: MIT
"""Requests of the commands, each declared once; light modules that load neither torch nor pydrake."""
