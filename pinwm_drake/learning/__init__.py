"""Policies: what they are, how they are trained, tested and exported. What to act in is passed in."""
