# SPDX-License-Identifier: MIT
"""The station: one diagram with the same ports for every engine."""
