# SPDX-License-Identifier: MIT
"""Differentiable rigid-body physics: parameters, model, state, contact, stepper."""
