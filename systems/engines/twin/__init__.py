"""The learned twin as an engine: LCP step, surfels, cousins."""
