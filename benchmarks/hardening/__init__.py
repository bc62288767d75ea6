# SPDX-License-Identifier: MIT
"""Attacks on the package: `python -m benchmarks.hardening`; see `__main__.py`."""
