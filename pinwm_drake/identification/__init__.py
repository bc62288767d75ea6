# SPDX-License-Identifier: MIT
"""Identification: the physical parameters of an object from the video of one push."""
