# SPDX-License-Identifier: MIT
"""Pushers: scripted motions, choice of pushes, limits, translations and the drive of a plant."""
