# SPDX-License-Identifier: MIT
"""Figures of single subjects, with matplotlib."""
