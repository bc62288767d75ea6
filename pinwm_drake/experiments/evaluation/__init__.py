"""Evaluation of policies in an engine: episodes, stored results, tables."""
