# SPDX-License-Identifier: MIT
"""Rehearsal of a bundle with a simulated arm over LCM in real time: normal work, and faults at random moments."""
