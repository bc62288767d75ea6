# SPDX-License-Identifier: MIT
"""A laboratory's numbers: calibration, table, and the clocks of film and log."""
