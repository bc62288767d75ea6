# SPDX-License-Identifier: MIT
"""Engines behind the ports of a station: the twin, Drake plants, and a robot over LCM."""
