# SPDX-License-Identifier: MIT
"""Identification from measured poses in place of images."""
