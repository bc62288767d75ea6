# SPDX-License-Identifier: MIT
"""Cameras: RgbdSensor with masks of the object, and cameras that see surfels."""
