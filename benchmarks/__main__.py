"""`python -m benchmarks`: run every benchmark and rewrite the tables of benchmarks/README.md."""

from benchmarks.run import main

main()
