# SPDX-License-Identifier: MIT
"""A simulated arm that carries the pusher, and its LCM driver."""
