# SPDX-License-Identifier: MIT
"""Scripted runs of a station: episodes, recordings, simulated captures, films."""
