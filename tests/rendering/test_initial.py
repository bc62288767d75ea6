# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.errors import RenderingError
from pinwm_drake.rendering.harmonics import Y0
from pinwm_drake.rendering.initial import initial_surfels
from pinwm_drake.rendering.patches import farthest, spread
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.silhouette import between_views, coverage
from pinwm_drake.spatial.poses import transform
from pinwm_drake.spatial.rotations import quaternion_to_matrix
from tests.rendering.boxes import BLUE, GREEN, RED, box, look_at, view_of, views_around


@pytest.fixture(scope="module")
def mesh():
    return box()


@pytest.fixture(scope="module")
def views(mesh):
    return views_around(mesh)


def test_surfels_lie_flat_on_what_is_seen(mesh, views):
    surfels = initial_surfels(mesh, views, 300, degree=2, opacity=0.7, num_threads=1)
    surfels.check()
    assert (surfels.num_surfels, surfels.degree) == (300, 2)
    points = surfels.p_OS.double().numpy()
    # On the box: one coordinate is that of a face, the others are inside. float32 of centimetres: some 1e-9 m.
    outside = np.abs(points) / (0.5 * np.array([0.10, 0.06, 0.04]))
    assert np.abs(outside.max(1) - 1.0).max() < 1e-6
    normals = quaternion_to_matrix(surfels.q_OS.double())[:, :, 2].numpy()
    faces = outside.argmax(1)
    signs = np.sign(points[np.arange(300), faces])
    assert np.abs(normals[np.arange(300), faces] * signs - 1.0).max() < 1e-5
    # All views look from above.
    assert not np.any((faces == 2) & (signs < 0))
    assert torch.allclose(surfels.logit_opacity.sigmoid(), torch.tensor(0.7))
    assert bool((surfels.sh[:, 1:] == 0.0).all())


def test_surfels_have_the_colours_of_their_faces(mesh, views):
    surfels = initial_surfels(mesh, views, 300, num_threads=1)
    faces = (surfels.p_OS.abs() / (0.5 * torch.tensor([0.10, 0.06, 0.04]))).argmax(1)
    colors = surfels.sh[:, 0] * Y0 + 0.5
    error = (colors - torch.tensor([RED, GREEN, BLUE])[faces]).abs().max(1).values
    # Those next to an edge may take a pixel of the face beyond.
    assert float((error < 1e-5).float().mean()) > 0.6
    assert float(error.median()) < 1e-5


def test_they_look_like_the_object(mesh, views):
    surfels = initial_surfels(mesh, views, 500, opacity=0.95, num_threads=1)
    for view in views[:3]:
        rendering = render(surfels, view.camera, view.X_CO, num_threads=1)
        # A white image has errors of 1 in alpha on the mask; outlines blurred by a pixel cost a fifth of that here.
        assert float((rendering.alpha[0] - view.mask.float()).abs().sum() / view.mask.sum()) < 0.3
        inner = rendering.alpha[0] > 0.95
        assert float((rendering.color[0] - view.image)[inner & view.mask].abs().median()) < 0.05


def test_creases_are_lined_with_narrow_surfels_that_lie_along_them(mesh, views):
    surfels = initial_surfels(mesh, views, 400, crease_share=0.5, num_threads=1)
    scale = surfels.log_scale.exp()
    half = 0.5 * torch.tensor([0.10, 0.06, 0.04])
    # The distance to the nearest edge is the middle one of the distances to the three pairs of faces.
    to_edge = (half - surfels.p_OS.abs()).sort(1).values[:, 1]
    pixel = 0.3 / (1.6 * 48)
    lined = to_edge < pixel
    assert 50 <= int(lined.sum()) <= 250
    plain = initial_surfels(mesh, views, 400, crease_share=0.0, num_threads=1)
    assert float(scale[lined].min(1).values.median()) < float(plain.log_scale.exp().median())
    # They stay inside, but near corners, where another edge is nearer than the one they line.
    assert float((scale.min(1).values < to_edge).float().mean()) > 0.9


def test_a_smooth_mesh_has_no_creases(views):
    ball = trimesh.creation.icosphere(3, 0.03)
    eyes = [(0.2, 0.0, 0.2), (-0.2, 0.1, 0.2)]
    surfels = initial_surfels(ball, [view_of(ball, "ball", eye) for eye in eyes], 200, num_threads=1)
    assert surfels.num_surfels == 200
    assert float(surfels.log_scale.max() - surfels.log_scale.min()) < 1e-5


def test_hidden_inner_faces_get_none(views):
    # Two boxes that touch: the wall between them is a surface of both, but no view sees it.
    parts = [trimesh.creation.box((0.05, 0.06, 0.04)) for _ in range(2)]
    for part, x in zip(parts, (-0.025, 0.025), strict=True):
        part.apply_translation((x, 0.0, 0.0))
    mesh = trimesh.util.concatenate(parts)
    surfels = initial_surfels(mesh, views, 400, crease_share=0.0, num_threads=1)
    wall = (surfels.p_OS[:, 0].abs() < 1e-6) & (surfels.p_OS[:, 2] < 0.01) & (surfels.p_OS[:, 1].abs() < 0.02)
    assert int(wall.sum()) == 0


def test_the_same_seed_gives_the_same_surfels(mesh, views):
    one, two, other = (initial_surfels(mesh, views, 100, seed=seed, num_threads=1) for seed in (5, 5, 6))
    for name, tensor in one.tensors().items():
        assert torch.equal(tensor, two.tensors()[name])
    assert not torch.equal(one.p_OS, other.p_OS)


def test_what_does_not_fit_is_named(mesh, views):
    with pytest.raises(RenderingError, match=r"number=0, degree=0, .* allowed: 1 or more, 0 to 3"):
        initial_surfels(mesh, views, 0)
    with pytest.raises(RenderingError, match="got 0 views"):
        initial_surfels(mesh, [], 10)
    behind = trimesh.Trimesh(np.add(mesh.vertices, [5.0, 0.0, 0.0]), mesh.faces, process=False)
    with pytest.raises(RenderingError, match="a mesh behind the cameras"):
        initial_surfels(behind, views[:1], 10, num_threads=1)
    aside = trimesh.Trimesh(np.add(mesh.vertices, [-3.0, 5.0, 0.0]), mesh.faces, process=False)
    with pytest.raises(RenderingError, match="found nothing of the mesh in the views"):
        initial_surfels(aside, views[:1], 10, num_threads=1)


def test_samples_cover_faces_by_area(mesh):
    patches = spread(mesh, 2000, np.random.default_rng(0))
    share = np.mean(np.abs(patches.normals[:, 2]) > 0.5)
    # Stratified: each face has its number to within one sample, and z's have 4 triangles.
    assert share == pytest.approx(2 * 0.10 * 0.06 / mesh.area, abs=4 / 2000)


def test_farthest_points_keep_apart():
    points = np.random.default_rng(0).random((500, 3))
    chosen, gap = farthest(points, points[:1], 20)
    kept = np.concatenate([points[:1], points[chosen]])
    distances = np.linalg.norm(kept[:, None] - kept[None], axis=2) + 9.0 * np.eye(21)
    assert distances.min() == pytest.approx(gap)


def test_coverage_is_the_area_of_a_projected_square():
    # A cube of 0.2 m seen along an axis from 1 m: its front face, 0.9 m away, is 0.2 / 0.9 * fx px wide.
    cube = trimesh.creation.box((0.2, 0.2, 0.2))
    view = view_of(cube, "front", (1.0, 1e-9, 0.0), size=64)
    covered = coverage(cube, view.camera, view.X_CO)
    side = 0.2 / 0.9 * 1.6 * 64
    # A pixel counts as a whole where its centre is covered: to within half a pixel on each side.
    assert abs(float(covered.sum()) ** 0.5 - side) <= 1.0
    assert set(covered.unique().tolist()) == {0.0, 1.0}


def test_poses_between_views_turn_by_the_spread(mesh):
    X_CO = look_at((0.2, 0.15, 0.15))
    generator = np.random.default_rng(0)
    still = between_views(mesh, X_CO, 0.0, generator)
    assert torch.allclose(still.q, X_CO.q)
    assert torch.allclose(still.p, X_CO.p)
    moved = between_views(mesh, X_CO, 0.3, generator)
    corner = torch.tensor([0.05, 0.03, 0.02], dtype=torch.float64)
    assert float((transform(moved, corner) - transform(X_CO, corner)).norm()) > 1e-3
    # The middle of the object stays where it is in the camera frame.
    assert torch.allclose(moved.p, X_CO.p, atol=1e-12)
