# SPDX-License-Identifier: MIT
"""File of cousins: an npz without pickles that holds their values, the draw, and the hash of their twin."""

import hashlib
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pinwm_drake.checkpoints import load_arrays, write_arrays
from pinwm_drake.cousins.cousin import Cousin, CousinDraw, Cousins, twin_shape
from pinwm_drake.cousins.theta import KEYS
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.twin.rollout import NO_EFFECT
from pinwm_drake.twin.twin import Twin

_VERSION = 2
_KEYS = ("version", "twin", "delta", "from_intervals", "seed", "ranges", "theta_keys", "sha256")
_ARRAYS = ("theta", "shape", "sh", "moved")
_ALLOWED = "cousins, as `pinwm cousins` writes them"


def write_cousins(path: Path, cousins: Cousins) -> None:
    """Write cousins, whole or not at all.

    Args:
        path: The file, which ends in .npz; its folder exists.
        cousins: The cousins; each takes about 1 MB with 5000 surfels of degree 3.

    Raises:
        InputError: The file cannot be written, or a mesh of the twin cannot be read.
    """
    draw = cousins.draw
    arrays = {
        "theta": np.array([[cousin.theta[key] for key in KEYS] for cousin in cousins.members]),
        "shape": np.array([[cousin.shape[key] for key in NO_EFFECT] for cousin in cousins.members]),
        "sh": cousins.sh().numpy(),
        "moved": np.array([cousin.moved for cousin in cousins.members]),
    }
    about: dict[str, Any] = {
        "version": _VERSION,
        "twin": hash_twin(draw.twin),
        "delta": draw.delta,
        "from_intervals": draw.from_intervals,
        "seed": draw.seed,
        "ranges": {key: [one.low, one.high, one.source] for key, one in draw.ranges.items()},
        "theta_keys": list(KEYS),
    }
    write_arrays(path, about | {"sha256": hash_cousins(about, arrays)}, arrays)


def read_cousins(path: Path, twin: Twin) -> Cousins:
    """Read the cousins of a twin from a file: the very ones that `write_cousins` wrote.

    Raises:
        InputError: The file is missing, is no file of cousins, was changed, or its cousins are another twin's.
    """
    if not path.is_file():
        raise InputError(path, value="no such file", allowed=_ALLOWED)
    found, about = load_arrays(path, _ALLOWED)
    _check(path, about, found, twin)
    try:
        draw = CousinDraw(twin, delta=about["delta"], from_intervals=bool(about["from_intervals"]), seed=about["seed"])
    except (ParameterError, TypeError) as error:
        raise InputError(path, value=str(error), allowed=_ALLOWED) from error
    thetas = [dict(zip(KEYS, row, strict=True)) for row in found["theta"].tolist()]
    shapes = [dict(zip(NO_EFFECT, row, strict=True)) for row in found["shape"].tolist()]
    looks = zip(torch.from_numpy(found["sh"]), found["moved"].tolist(), strict=True)
    rows = enumerate(zip(thetas, shapes, looks, strict=True))
    members = (Cousin(twin, number, theta, shape, partial(tuple, own)) for number, (theta, shape, own) in rows)
    return Cousins(draw, tuple(members))


def _check(path: Path, about: dict[str, Any], arrays: dict[str, np.ndarray], twin: Twin) -> None:
    if about.get("version") != _VERSION or set(about) != set(_KEYS) or set(arrays) != set(_ARRAYS):
        raise InputError(path, value=f"version {about.get('version')} of something", allowed=_ALLOWED)
    if about["sha256"] != hash_cousins({key: value for key, value in about.items() if key != "sha256"}, arrays):
        raise InputError(path, value="contents that were changed", allowed=_ALLOWED)
    expected = hash_twin(twin)
    if about["twin"] != expected:
        allowed = f"of {expected[:12]}..., the one at hand ({twin.name})"
        raise InputError(path, value=f"cousins of the twin {str(about['twin'])[:12]}...", allowed=allowed)
    n, wanted = arrays["moved"].size, dict.fromkeys(_ARRAYS, np.float64) | {"sh": np.float32}
    shapes = {"theta": (n, len(KEYS)), "shape": (n, len(NO_EFFECT)), "sh": (n, *twin.surfels.sh.shape), "moved": (n,)}
    for name, array in arrays.items():
        if n == 0 or array.shape != shapes[name] or array.dtype != wanted[name] or not np.isfinite(array).all():
            allowed = f"finite {np.dtype(wanted[name])} of shape {shapes[name]}, 1 cousin or more"
            raise InputError(path, value=f"{name} of {array.dtype}, {array.shape}", allowed=allowed)


def hash_twin(twin: Twin) -> str:
    """SHA-256 of all that a twin's motion and looks depend on: not of its name, provenance or place on disk.

    Writing and reading a twin does not change its hash. Raises InputError where a mesh cannot be read.
    """
    shape = twin.pusher.shape
    plain = {
        "gravity": float(twin.gravity),
        "floor_height": float(twin.floor_height),
        "time_step": float(twin.time_step),
        "friction_directions": 32,  # what twins of version 0.1 held, whose hashes stand in files
        "support": twin.support,
        "pusher": None if shape is None else [shape.kind, float(shape.radius), float(shape.length)],
        "theta": {
            key: [float(one.value), None if one.interval is None else [float(end) for end in one.interval]]
            for key, one in twin.theta.items()
        },
        "shape": twin_shape(twin),
        "draws": None if twin.draws is None else [twin.draws.names, twin.draws.values.tolist()],
    }
    digest = hashlib.sha256(json.dumps(plain, sort_keys=True).encode())
    meshes = [twin.mesh_path]
    if twin.pusher.mesh_path is not None and shape is None:
        meshes.append(twin.pusher.mesh_path)
    for path in meshes:
        digest.update(hashlib.sha256(read_bytes(path)).digest())
    for name, tensor in twin.surfels.tensors().items():
        digest.update(f"{name} {tuple(tensor.shape)}".encode())
        digest.update(np.ascontiguousarray(tensor.detach().numpy()).tobytes())
    return digest.hexdigest()


def hash_cousins(about: dict[str, Any], arrays: dict[str, np.ndarray]) -> str:
    """SHA-256 of what a file of cousins holds."""
    digest = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    for name in _ARRAYS:
        digest.update(f"{name} {arrays[name].dtype} {arrays[name].shape}".encode())
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()
