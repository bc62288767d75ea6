# SPDX-License-Identifier: MIT
"""Readers of files that others wrote: regular files alone, limits before anything is allocated, errors of one line.

Every reader of the package goes through this folder, and the checks of meaning come after it.
"""
