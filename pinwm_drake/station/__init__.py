# SPDX-License-Identifier: MIT
"""A lab's station: the calibration board, the calibration, and the document `station.yaml`."""
