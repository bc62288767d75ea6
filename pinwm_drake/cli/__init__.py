"""The command line `pinwm`. It may import everything, and nothing imports it."""

from pinwm_drake.cli.app import main

__all__ = ["main"]
