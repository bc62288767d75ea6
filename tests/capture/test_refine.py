# SPDX-License-Identifier: MIT
import shutil

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from pinwm_drake.capture.refine import refine_capture
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import InputError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import model_path

CAPTURE = model_path("captures/t_block/capture.yaml").parent


@pytest.fixture
def noisy(tmp_path):
    """The capture that ships, the vertices of its mesh moved by 4 mm."""
    folder = tmp_path / "noisy"
    shutil.copytree(CAPTURE, folder)
    path = load_capture(folder).object.mesh_path
    mesh = load_mesh(path)
    mesh.merge_vertices()
    mesh.vertices = mesh.vertices + np.random.default_rng(1).normal(0.0, 0.004, mesh.vertices.shape)
    mesh.export(path)
    return folder


def away(mesh):
    """Distances [m] of points on a mesh from the true one."""
    true = trimesh.sample.sample_surface(load_mesh(load_capture(CAPTURE).object.mesh_path), 100_000, seed=0)[0]
    return cKDTree(true).query(trimesh.sample.sample_surface(mesh, 3000, seed=1)[0])[0]


def test_the_mesh_of_the_copy_is_as_the_masks_show_it_and_the_rest_is_as_it_was(noisy, tmp_path):
    found = refine_capture(noisy, tmp_path / "out")
    given, refined = (load_mesh(load_capture(folder).object.mesh_path) for folder in (noisy, tmp_path / "out"))
    np.testing.assert_allclose(refined.vertices, found.mesh.vertices, atol=1e-6)
    assert np.quantile(away(given), 0.9) > 0.003
    assert np.quantile(away(refined), 0.9) < 0.001
    names = [
        sorted(str(path.relative_to(folder)) for path in folder.rglob("*")) for folder in (noisy, tmp_path / "out")
    ]
    assert names[0] == names[1]
    assert (noisy / "capture.yaml").read_bytes() == (tmp_path / "out/capture.yaml").read_bytes()


def test_what_cannot_be_refined_is_told(noisy, tmp_path):
    with pytest.raises(InputError, match="inside: got a folder within the capture"):
        refine_capture(noisy, noisy / "inside")
    (tmp_path / "full").mkdir()
    (tmp_path / "full/file").touch()
    with pytest.raises(InputError, match="full: got something there already"):
        refine_capture(noisy, tmp_path / "full")
    path = load_capture(noisy).object.mesh_path
    load_mesh(path).subdivide().subdivide().export(path)
    with pytest.raises(InputError, match="vertices; allowed: at most 64"):
        refine_capture(noisy, tmp_path / "out")
    elsewhere = tmp_path / "elsewhere.obj"
    shutil.move(path, elsewhere)
    path.symlink_to(elsewhere)
    with pytest.raises(InputError, match="got a mesh elsewhere"):
        refine_capture(noisy, tmp_path / "out")
    assert not (tmp_path / "out").exists()
