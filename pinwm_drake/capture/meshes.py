"""The meshes of a capture, refused with a message whatever their files hold."""

import warnings
from pathlib import Path

import trimesh

from pinwm_drake.capture.paths import require_file
from pinwm_drake.errors import InputError, PinwmError
from pinwm_drake.geometry.meshes import load_mesh


def read_mesh(path: Path) -> trimesh.Trimesh:
    """Reads a closed triangle mesh: `load_mesh`, for files that anything may stand in.

    Args:
        path: The file, coordinates in metres.

    Returns:
        The mesh.

    Raises:
        InputError: As for `load_mesh`, or its faces make no sense.
    """
    require_file(path, "a mesh file: .obj, .stl, .ply or .glb")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # trimesh divides by areas and volumes of nothing
            return load_mesh(path)
    except PinwmError:
        raise
    except Exception as error:  # faces that name corners that are not there, and what else a broken file leads to
        found = f"a mesh that cannot be used ({type(error).__name__}: {_first_line(error)})"
        raise InputError(path, value=found, allowed="a watertight triangle mesh") from error


def _first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), "")[:120]
