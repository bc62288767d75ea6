# SPDX-License-Identifier: MIT
"""Drake systems and diagrams of the pushing scene; the only part of pinwm_drake that defines Drake systems."""
