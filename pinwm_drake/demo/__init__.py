# SPDX-License-Identifier: MIT
"""Demonstrations of `pinwm demo`: the main job from a capture to a policy, and one push with its derivatives."""
