"""Demonstrations of `pinwm demo`."""
