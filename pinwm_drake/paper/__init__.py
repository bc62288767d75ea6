# SPDX-License-Identifier: MIT
"""The paper's comparison: the other methods, its tables and the experiments that only they need."""
