"""Draws from the posterior of a twin, to and from `draws.npz`."""

import zipfile
from pathlib import Path

import numpy as np

from pinwm_drake.errors import InputError
from pinwm_drake.files import replacing
from pinwm_drake.twin.twin import Draws


def write_draws(path: Path, draws: Draws) -> None:
    """Writes the draws of a twin.

    Raises:
        InputError: The file cannot be written.
    """
    with replacing(path) as temporary:
        np.savez(temporary, allow_pickle=False, names=np.array(draws.names), values=draws.values)


def read_draws(path: Path) -> Draws:
    """Reads the draws of a twin.

    Raises:
        InputError: The file is missing, unreadable, or its arrays are no table of finite numbers with a name for each
            column.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            names, values = file["names"], file["values"]
    except (OSError, ValueError, TypeError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(
            path, value=f"unreadable contents ({error})", allowed="names and values, no pickles"
        ) from error
    if values.ndim != 2 or names.shape != values.shape[1:] or not len(values) or values.dtype.kind != "f":
        raise InputError(path, value=f"names {names.shape}, values {values.shape}", allowed="(p,) and (N, p), N > 0")
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        row, column = wrong[0]
        raise InputError(path, value=f"{values[row, column]} in row {row} of {names[column]}", allowed="finite numbers")
    return Draws([str(name) for name in names], values)
