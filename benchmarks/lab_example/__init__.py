# SPDX-License-Identifier: MIT
"""Worked example of docs/how-to/lab.md: a rendered lab that a person fills act by act, and what the guide finds."""
