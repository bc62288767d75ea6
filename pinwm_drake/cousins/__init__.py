# SPDX-License-Identifier: MIT
"""Digital cousins of a twin: copies whose physical parameters and colours are a little different."""
