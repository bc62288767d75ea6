"""Model-predictive control of the planar push with CasADi."""
