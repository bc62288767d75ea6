# SPDX-License-Identifier: MIT
"""Masks of an object in photos of a lab, its pose, and what is doubtful about them."""
