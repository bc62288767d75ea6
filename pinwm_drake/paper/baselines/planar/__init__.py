"""Identification in the plane: a differentiable simulator of sliding cells, and the twin that its finds make.

Source: Song and Boularias, "Learning to slide unknown objects with differentiable physics simulations" (RSS 2020).
"""
