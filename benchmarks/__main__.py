# SPDX-License-Identifier: MIT
"""Entry point of `python -m benchmarks`: runs every benchmark and rewrites the tables of benchmarks/README.md."""

from benchmarks.run import main

main()
