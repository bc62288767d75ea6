# SPDX-License-Identifier: MIT
"""Captures as a lab has them: objects that are uneven, one lamp, and mistakes of poses, clocks, cameras and masks."""
