# SPDX-License-Identifier: MIT
import numpy as np

from pinwm_drake.geometry.meshes import load_mesh
from tests.capture.cube import SIDE
from tests.capture.pushed_cube import write_pushed_cube


def test_a_mesh_comes_nearer_to_what_the_masks_show(pinwm, tmp_path):
    folder, out = write_pushed_cube(tmp_path / "capture"), tmp_path / "refined"
    path = folder / "meshes/object.obj"
    mesh = load_mesh(path)
    mesh.merge_vertices()
    mesh.vertices = mesh.vertices * [1.15, 1.0, 0.9]
    mesh.export(path)
    code, told, err = pinwm("capture", "refine", str(folder), str(out))
    assert (code, err) == (0, "")
    assert "of the object's pixels instead of" in told
    assert f"wrote {out}" in told
    refined = load_mesh(out / "meshes/object.obj")
    away = [np.abs(np.abs(one.vertices) - SIDE / 2).mean() for one in (mesh, refined)]
    assert away[1] < 0.5 * away[0]


def test_one_that_is_there_already_is_not_overwritten(pinwm, tmp_path):
    folder = write_pushed_cube(tmp_path / "capture")
    code, _, err = pinwm("capture", "refine", str(folder), str(folder.parent))
    assert code != 0
    assert "got something there already; allowed: a new or empty folder" in err.replace("\n", " ")
