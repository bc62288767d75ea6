# SPDX-License-Identifier: MIT
"""The twin format: one object with its physical parameters and its appearance, read, checked and written."""
