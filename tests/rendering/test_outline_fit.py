# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import Delaunay

from pinwm_drake.errors import ParameterError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.outline_fit import MOST_VERTICES, fit_outline
from pinwm_drake.rendering.views import View
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_to_matrix

SIZE, FOCAL, FAR = 160, 300.0, 0.4
CENTRES = np.stack(np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5), -1)


def box():
    """A box of 60 x 40 x 30 mm."""
    return trimesh.creation.box((0.06, 0.04, 0.03))


def views(mesh, number=10):
    """Views of a convex mesh from all around; masks are the pixels within its corners' hull."""
    generator, found = np.random.default_rng(3), []
    camera = Camera(SIZE, SIZE, torch.tensor([FOCAL, FOCAL, SIZE / 2, SIZE / 2], dtype=torch.float64))
    for k in range(number):
        q = quaternion_exp(torch.from_numpy(generator.normal(0.0, 2.0, 3)))
        p = torch.tensor([0.0, 0.0, FAR], dtype=torch.float64)
        at = mesh.vertices @ quaternion_to_matrix(q).numpy().T + p.numpy()
        px = FOCAL * at[:, :2] / at[:, 2:] + SIZE / 2
        mask = Delaunay(px).find_simplex(CENTRES) >= 0
        image = torch.ones(SIZE, SIZE, 3)
        found.append(View(f"view {k}", camera, Pose(q, p), image, torch.from_numpy(mask)))
    return found


def noisy(mesh, deviation=0.003):
    """The mesh with all vertices moved by normal noise."""
    moved = mesh.copy()
    moved.vertices = mesh.vertices + np.random.default_rng(0).normal(0.0, deviation, mesh.vertices.shape)
    return moved


def test_vertices_come_back_to_where_masks_show_them():
    true, given, told = box(), noisy(box()), []
    found = fit_outline(views(true), given, progress=lambda share, loss: told.append((share, loss)))
    before, after = (np.linalg.norm(mesh.vertices - true.vertices, axis=1) for mesh in (given, found.mesh))
    assert before.mean() > 0.004
    assert after.max() < 0.001  # a pixel has 1.3 mm
    assert found.after < 0.2 * found.before
    np.testing.assert_array_equal(found.mesh.faces, given.faces)
    np.testing.assert_allclose(found.moved, np.linalg.norm(found.mesh.vertices - given.vertices, axis=1))
    assert told[0][1] > 5.0 * told[-1][1]


def test_vertices_at_one_place_stay_together():
    whole = noisy(box())
    apart = trimesh.Trimesh(whole.vertices[whole.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    found = fit_outline(views(box()), apart).mesh
    assert len(np.unique(found.vertices, axis=0)) == 8


def test_a_mesh_that_fits_hardly_moves():
    found = fit_outline(views(box()), box())
    assert found.moved.max() < 0.0007
    assert found.after <= found.before


def test_too_many_vertices_and_no_views_are_refused():
    with pytest.raises(ParameterError, match=f"mesh: got 98 vertices; allowed: at most {MOST_VERTICES}"):
        fit_outline(views(box()), box().subdivide().subdivide())
    with pytest.raises(ParameterError, match="views: got 0"):
        fit_outline([], box())
