"""One push of the T-block, differentiated through every contact."""
