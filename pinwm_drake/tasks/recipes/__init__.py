"""Recipes of the tasks that ship."""
