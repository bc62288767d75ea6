# SPDX-License-Identifier: MIT
"""gymnasium and Stable-Baselines3 environments over stations."""
