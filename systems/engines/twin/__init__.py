# SPDX-License-Identifier: MIT
"""The learned twin as an engine: contact step, surfels, cousins."""
