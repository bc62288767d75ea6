# SPDX-License-Identifier: MIT
"""Model-predictive control of the planar push with CasADi; for `PushTask` alone, whose pusher moves along x and y."""
