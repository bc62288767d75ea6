# SPDX-License-Identifier: MIT
"""Surfels in PLY files, with the property names of 2D Gaussian Splatting, which other splat tools open.

A vertex is a surfel: x y z (m), nx ny nz (its normal; not read), f_dc_0..2 (harmonics of degree 0), f_rest_0.. (the
others, all of red, then green, then blue), opacity (logit), scale_0 scale_1 (logarithms of m), rot_0..3 (wxyz).
trimesh reads the files; what is written is a header and the numbers as they lie in memory.
"""

import os
import re
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.errors import InputError, RenderingError
from pinwm_drake.files import replacing
from pinwm_drake.reading.meshes import read_elements
from pinwm_drake.rendering.surfels import MAX_DEGREE, Surfels
from pinwm_drake.spatial.rotations import quaternion_to_matrix

_POSITION, _NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
_CONSTANT = ("f_dc_0", "f_dc_1", "f_dc_2")
_SCALE, _ROTATION = ("scale_0", "scale_1"), ("rot_0", "rot_1", "rot_2", "rot_3")
_NEEDED = (*_POSITION, *_CONSTANT, "opacity", *_SCALE, *_ROTATION)
# How many f_rest a file has, by degree: 0, 9, 24, 45.
_RESTS = [3 * ((degree + 1) ** 2 - 1) for degree in range(MAX_DEGREE + 1)]


def read_ply(path: str | os.PathLike[str]) -> Surfels:
    """Read surfels from a PLY file.

    Args:
        path: A PLY file, text or binary, with the properties above as float or double; 0, 9, 24 or 45 of f_rest.

    Returns:
        The surfels, bit for bit those that `write_ply` was given.

    Raises:
        InputError: The file is missing, no PLY, truncated, without a surfel, lacks a property or has it in another
            type, or holds a number that is not finite or a quaternion of 0; the message names property and row.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, value="no such file", allowed="a PLY file of surfels")
    rows, rests = _read_vertices(path)
    values = {name: _column(path, rows[name], name) for name in (*_NEEDED, *rests)}
    rotation = np.stack([values[name] for name in _ROTATION], -1)
    _check_rows(path, np.abs(rotation).max(-1) > 0.0, "rot_0..3 of 0", "quaternions of any length but 0")

    def tensor(names: tuple[str, ...]) -> torch.Tensor:
        return torch.from_numpy(np.stack([values[name] for name in names], -1))

    constant = tensor(_CONSTANT)[:, None, :]
    rest = tensor(rests).reshape(len(rotation), 3, -1).transpose(1, 2) if rests else constant[:, :0]
    return Surfels(
        p_OS=tensor(_POSITION),
        q_OS=torch.from_numpy(rotation),
        log_scale=tensor(_SCALE),
        logit_opacity=torch.from_numpy(values["opacity"]),
        sh=torch.cat([constant, rest], 1),
    )


def write_ply(path: str | os.PathLike[str], surfels: Surfels) -> None:
    """Write surfels as binary PLY, whole or not at all.

    Args:
        path: The file; an earlier one of that name is replaced.
        surfels: Surfels, one or more, with one set of colours: sh (N, K, 3).

    Raises:
        RenderingError: The surfels are not usable; nothing is written.
        InputError: The file cannot be written (no such folder, disk full); an earlier one stays as it was.
    """
    path = Path(path)
    if surfels.sh.ndim != 3:
        raise RenderingError(f"sh is {tuple(surfels.sh.shape)}; allowed in a PLY: (N, K, 3), one set of colours")
    if surfels.num_surfels == 0:
        raise RenderingError(f"no surfel to write to {path}; allowed: 1 or more")
    surfels.check()
    surfels = surfels.detach().to("cpu", torch.float32)
    N = surfels.num_surfels
    normal = quaternion_to_matrix(torch.nn.functional.normalize(surfels.q_OS.double(), dim=-1))[:, :, 2].float()
    rest = surfels.sh[:, 1:].transpose(1, 2).reshape(N, -1)
    names = (*_POSITION, *_NORMAL, *_CONSTANT, *_rest_names(rest.shape[1]), "opacity", *_SCALE, *_ROTATION)
    colours = (surfels.sh[:, 0], rest)
    columns = (surfels.p_OS, normal, *colours, surfels.logit_opacity[:, None], surfels.log_scale, surfels.q_OS)
    with replacing(path) as temporary:
        write_vertices(temporary, names, torch.cat(columns, 1).numpy())


def write_vertices(path: Path, names: tuple[str, ...], columns: np.ndarray) -> None:
    """Write columns (N, len(names)) as float32 vertices of a binary PLY file; raise OSError."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(columns)}"]
    header += [*(f"property float {name}" for name in names), "end_header", ""]
    path.write_bytes("\n".join(header).encode() + np.ascontiguousarray(columns, "<f4").tobytes())


def _rest_names(number: int) -> tuple[str, ...]:
    return tuple(f"f_rest_{i}" for i in range(number))


def _read_vertices(path: Path) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Columns of the vertices by name, and the names of f_rest, after a look at the names and types of all."""
    try:
        elements, contents = read_elements(path, "a PLY file of surfels")
    except InputError:
        raise
    except Exception as error:  # trimesh's reader raises whatever its parser does
        raise _unreadable(path, error) from error
    if "vertex" not in elements:
        found = ", ".join(elements) or "no element"
        raise InputError(path, value=f"a PLY with {found}", allowed="a PLY with an element 'vertex'")
    vertices = elements["vertex"]
    if vertices["length"] < 1:
        raise InputError(path, value=f"{vertices['length']} surfels", allowed="1 surfel or more")
    properties = vertices["properties"]
    missing = [name for name in _NEEDED if name not in properties]
    if missing:
        raise InputError(
            path, value=f"vertices without {', '.join(missing)}", allowed=f"the properties {', '.join(_NEEDED)}"
        )
    if "scale_2" in properties:
        raise InputError(path, value="scale_2, so 3D Gaussians", allowed="surfels of 2DGS, with scale_0 and scale_1")
    given = sorted(name for name in properties if name.startswith("f_rest_"))
    rests = _rest_names(len(given))
    if len(given) not in _RESTS or sorted(rests) != given:
        raise InputError(path, value=f"{len(given)} of f_rest", allowed="f_rest_0.. with 0, 9, 24 or 45 of them")
    for name, kind in properties.items():
        # A list is several types, divided by commas.
        if "," in kind or (name in (*_NEEDED, *rests) and "f" not in kind):
            line = re.search(rf"property [\w ]+ {re.escape(name)}\b", contents.decode("latin-1"))
            raise InputError(path, value=f"property '{line and line[0]}'", allowed=f"float or double {name}")
    try:
        rows = {name: np.asarray(vertices["data"][name], properties[name]).ravel() for name in (*_NEEDED, *rests)}
    except (KeyError, ValueError) as error:  # rows of text with too few numbers
        raise _unreadable(path, error) from error
    if len(rows["x"]) < vertices["length"]:
        value = f"a truncated file ({len(rows['x'])} of {vertices['length']} vertices)"
        raise InputError(path, value=value, allowed="a whole PLY file")
    return rows, rests


def _unreadable(path: Path, error: Exception) -> InputError:
    value = f"unreadable contents ({type(error).__name__}: {error})"
    if "unexpected length" in str(error):
        value = f"a truncated file, or one with more than its header says ({error})"
    return InputError(path, value=value, allowed="a PLY file of surfels")


def _column(path: Path, given: np.ndarray, name: str) -> np.ndarray:
    with np.errstate(over="ignore"):
        values = np.ascontiguousarray(given, np.float32)
    finite = np.isfinite(values)
    _check_rows(path, finite, f"{name} = {given[int(finite.argmin())]}", "finite numbers")
    return values


def _check_rows(path: Path, fits: np.ndarray, value: str, allowed: str) -> None:
    """Raise InputError for the first row that does not fit; rows are surfels, counted from 1."""
    if not fits.all():
        raise InputError(path, row=int(fits.argmin()) + 1, value=value, allowed=allowed)
