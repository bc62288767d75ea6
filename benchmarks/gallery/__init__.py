# SPDX-License-Identifier: MIT
"""The gallery: six pushed objects with twin, prediction, film and page."""
