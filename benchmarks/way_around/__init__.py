# SPDX-License-Identifier: MIT
"""A point that is to get around an obstacle by either of two ways: diffusion policy beside regression to the mean."""
