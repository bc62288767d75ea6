"""PIN-WM in Drake's idiom: calibrated digital twins of pushed objects, and policies trained in them.

Importing this package loads nothing heavy: no torch, numba, pydrake or matplotlib. Import the parts instead,
for example `from pinwm_drake.physics import Model`.
"""

from pathlib import Path

__version__ = "0.1.0"

# `systems` and `models` are top-level folders of the repository and install inside this package. A checkout
# that is not installed finds them next to this package; an installed package has no pyproject.toml beside it.
_checkout = Path(__file__).resolve().parent.parent
if (_checkout / "pyproject.toml").is_file():
    __path__.append(str(_checkout))
