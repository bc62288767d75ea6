"""PIN-WM in Drake's idiom: calibrated digital twins of pushed objects, and policies trained in them.

Importing this package loads nothing heavy: no torch, numba, pydrake or matplotlib. Import the parts instead,
for example `from pinwm_drake.physics import Model`.
"""

__version__ = "0.2.0"
