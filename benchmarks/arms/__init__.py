# SPDX-License-Identifier: MIT
"""Episodes of a bundle by a simulated arm over LCM."""
