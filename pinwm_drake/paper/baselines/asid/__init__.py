# SPDX-License-Identifier: MIT
"""ASID: theta by a cross-entropy search on tracked poses."""
