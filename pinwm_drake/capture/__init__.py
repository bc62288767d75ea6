# SPDX-License-Identifier: MIT
"""Capture format, a robot's records of an object: read, checked and written."""
