# SPDX-License-Identifier: MIT
"""A capture whose mesh is fitted to the masks of its static views."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pinwm_drake.capture.scene import read_capture_object
from pinwm_drake.capture.static_views import read_views
from pinwm_drake.errors import InputError
from pinwm_drake.files import appearing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.outline_fit import MOST_VERTICES, OutlineFit, fit_outline
from pinwm_drake.rendering.registration import register, registered
from pinwm_drake.spatial.rotations import quaternion_to_matrix


def refine_capture(
    capture: Path, out: Path, *, progress: Callable[[float, float], None] = lambda share, loss: None
) -> OutlineFit:
    """Copy a capture, with a mesh whose outlines are those of the masks; see `fit_outline`.

    The object is looked for in the views first, as `align` does, since its pose may be a little wrong too.

    Args:
        capture: The capture, with its mesh in its folder.
        out: Folder of the copy: not there yet, or empty. It appears when all is done.
        progress: Called after each step with the share of the work that is done, and the mean square of the misfit.



    Raises:
        InputError: A file is missing or refused, the mesh has more than 64 vertices or lies elsewhere, or a file cannot
            be written.
    """
    if out.resolve().is_relative_to(capture.resolve()):
        raise InputError(out, value="a folder within the capture", allowed="a folder elsewhere")
    about = read_capture_object(capture)
    path = about.mesh_path.resolve()
    if not path.is_relative_to(capture.resolve()):
        raise InputError(about.mesh_path, value="a mesh elsewhere", allowed=f"a mesh within {capture}")
    with appearing(out) as folder:
        mesh = load_mesh(path)
        number = len(np.unique(mesh.vertices, axis=0))
        if number > MOST_VERTICES:
            raise InputError(about.mesh_path, value=f"{number} vertices", allowed=f"at most {MOST_VERTICES}")
        views = read_views(capture / "static", about.X_WO, mesh=mesh)
        views = registered(views, register(views, mesh, quaternion_to_matrix(about.X_WO.q)[2].numpy()))
        found = fit_outline(views, mesh, progress=progress)
        shutil.copytree(capture, folder, dirs_exist_ok=True)
        to = folder / path.relative_to(capture.resolve())
        found.mesh.export(to)
        load_mesh(to)
    return found
