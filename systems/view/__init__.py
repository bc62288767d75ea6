"""Meshcat views of a station."""
