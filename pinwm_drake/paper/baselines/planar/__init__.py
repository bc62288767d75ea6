# SPDX-License-Identifier: MIT
"""2D Physics: identification in the plane by a differentiable simulator of sliding cells."""
