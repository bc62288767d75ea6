# SPDX-License-Identifier: MIT
"""Offset between the clock of a film and that of the pusher's log, and what is wrong where there is none."""
