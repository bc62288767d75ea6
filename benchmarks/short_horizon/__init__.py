"""Trial of a teacher that learns by gradient through the step, beside SAC; see `__main__`."""
