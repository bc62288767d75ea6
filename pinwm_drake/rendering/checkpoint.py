"""Checkpoints of a fit: one npz file, which appears whole or not at all."""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
import trimesh
from torch import Tensor

from pinwm_drake.checkpoints import read_arrays, write_arrays
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.views import View

FILE = "checkpoint.npz"
_VERSION = 1
# These may change between a fit and its continuation.
_FREE = ("checkpoint_every",)


def describe(views: Sequence[View], mesh: trimesh.Trimesh, options: FitOptions, threads: int) -> dict[str, object]:
    """Description of a fit's inputs: its options, and the hash of its views and mesh."""
    digest = hashlib.sha256()
    for view in views:
        digest.update(f"{view.name} {view.camera.width} {view.camera.height}".encode())
        for tensor in (view.camera.intrinsics, view.X_CO.q, view.X_CO.p, view.image, view.mask):
            digest.update(tensor.numpy().tobytes())
    digest.update(np.asarray(mesh.vertices, float).tobytes())
    digest.update(np.asarray(mesh.faces, np.int64).tobytes())
    kept = {name: value for name, value in asdict(options).items() if name not in _FREE}
    return {"version": _VERSION, "views and mesh": digest.hexdigest(), **kept, "num_threads": threads}


def write_checkpoint(folder: Path, about: dict[str, object], arrays: dict[str, Tensor]) -> None:
    """Writes a checkpoint over the earlier one.

    Args:
        folder: exists.
        about: description of the fit by `describe`.
        arrays: arrays to keep, by name.

    Raises:
        InputError: it cannot be written; the earlier one stays.
    """
    write_arrays(folder / FILE, about, {name: value.numpy() for name, value in arrays.items()})


def read_checkpoint(folder: Path, about: dict[str, object], names: Iterable[str]) -> dict[str, Tensor] | None:
    """Reads the checkpoint of a folder.

    Args:
        folder: folder of the checkpoint.
        about: description by `describe` of the fit that wants to go on.
        names: names of the arrays that it has to hold.

    Returns:
        Its arrays, or None where there is no checkpoint.

    Raises:
        InputError: it cannot be read, or is of another fit; the message names what differs.
    """
    arrays = read_arrays(folder / FILE, about, "fit", names)
    return None if arrays is None else {name: torch.from_numpy(value) for name, value in arrays.items()}
