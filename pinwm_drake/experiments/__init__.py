"""Evaluations and trainings as library calls, with results on disk."""
