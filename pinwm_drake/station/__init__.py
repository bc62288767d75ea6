# SPDX-License-Identifier: MIT
"""A lab's station: calibration board, calibration, clocks of film and log, and the document `station.yaml`."""
