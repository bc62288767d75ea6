"""A robot behind LCM messages as an engine."""
