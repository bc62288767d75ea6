# SPDX-License-Identifier: MIT
"""Side-by-side timings of pinwm_drake.

`python -m benchmarks` runs every one and rewrites the tables of `benchmarks/README.md`. A single one runs as
`python -m benchmarks.step`, and so on. Importing this package loads nothing: each benchmark first fixes its
threads (`timing.limit_threads`) and only then imports the libraries that read them.
"""
