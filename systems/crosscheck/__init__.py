# SPDX-License-Identifier: MIT
"""Cross-check of a twin against the contact models of Drake."""
