# SPDX-License-Identifier: MIT
"""Scenarios: the YAML schema, its check, loading by name or twin, and everything that engines need of one."""
