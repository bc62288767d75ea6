"""Figures of single subjects, with matplotlib."""
