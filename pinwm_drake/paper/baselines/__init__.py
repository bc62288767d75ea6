# SPDX-License-Identifier: MIT
"""Methods that make a policy or controller from data and worlds; trained, evaluated and compared alike."""
