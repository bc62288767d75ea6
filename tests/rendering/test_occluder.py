# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.errors import RenderingError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.occluder import mesh_depth

CAMERA = Camera(32, 24, torch.tensor([31.0, 29.0, 15.2, 12.7], dtype=torch.float64))


def cast(mesh, camera, near):
    """The same by casting a ray through each pixel's centre: where it meets the plane of each triangle."""
    fx, fy, cx, cy = camera.intrinsics.tolist()
    rows, columns = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([(columns + 0.5 - cx) / fx, (rows + 0.5 - cy) / fy, np.ones(rows.shape)], axis=-1).reshape(-1, 3)
    depth = np.full(len(rays), np.inf)
    for corners, normal in zip(mesh.triangles, mesh.face_normals, strict=True):
        with np.errstate(divide="ignore"):
            z = (corners[0] @ normal) / (rays @ normal)
        ahead = np.isfinite(z) & (z >= near)
        points = rays[ahead] * z[ahead, None]
        weights = trimesh.triangles.points_to_barycentric(np.repeat(corners[None], len(points), axis=0), points)
        hit = np.flatnonzero(ahead)[(weights >= 0).all(axis=1)]
        depth[hit] = np.minimum(depth[hit], z[hit])
    return depth.reshape(rows.shape)


def placed(mesh, seed, place):
    turn = trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3))
    turn[:3, 3] = place
    return mesh.copy().apply_transform(turn)


SHAPES = [
    trimesh.creation.icosphere(subdivisions=2, radius=0.1),
    trimesh.creation.cylinder(0.05, 0.3, sections=24),
    trimesh.creation.box((0.1, 0.2, 0.3)),
]


@pytest.mark.parametrize("mesh", SHAPES, ids=["sphere", "cylinder", "box"])
@pytest.mark.parametrize(
    "place",
    [(0, 0, 0.5), (0.2, -0.15, 0.6), (-0.25, 0.1, 0.45), (0.02, 0.01, 0.06), (0.02, 0.01, -0.02)],
    ids=["middle", "corner", "side", "through the near plane", "around the camera"],
)
def test_depths_are_those_of_ray_casts(mesh, place):
    mesh = placed(mesh, 1, place)
    found = mesh_depth(np.array(mesh.vertices)[None], mesh.faces, CAMERA, 0.01)[0]
    expected = cast(mesh, CAMERA, 0.01)
    assert found.dtype == np.float32
    hit = np.isfinite(expected)
    assert hit.any()
    np.testing.assert_array_equal(np.isfinite(found), hit)
    # float32 of half a metre: 3e-8 m.
    np.testing.assert_allclose(found[hit], expected[hit], rtol=0, atol=1e-7)


def test_views_have_meshes_and_intrinsics_of_their_own():
    meshes = [placed(SHAPES[1], seed, (0.05 * seed, 0, 0.5)) for seed in range(3)]
    corners = np.stack([mesh.vertices for mesh in meshes])
    many = Camera(32, 24, CAMERA.intrinsics * torch.tensor([[1.0], [0.9], [1.2]], dtype=torch.float64))
    found = mesh_depth(corners, meshes[0].faces, many)
    assert found.shape == (3, 24, 32)
    for v in range(3):
        alone = Camera(32, 24, many.intrinsics[v])
        np.testing.assert_array_equal(found[v], mesh_depth(corners[v : v + 1], meshes[0].faces, alone)[0])
    # One set of intrinsics serves all views; the corners may be a tensor.
    shared = mesh_depth(torch.from_numpy(corners), meshes[0].faces, CAMERA)
    np.testing.assert_array_equal(shared[2], mesh_depth(corners[2:], meshes[0].faces, CAMERA)[0])


def test_a_mesh_behind_the_camera_or_outside_its_image_is_not_seen():
    corners = np.array(SHAPES[0].vertices)
    for place in ((0, 0, -0.5), (3.0, 0, 0.5), (1e9, 0, 0.5)):
        assert np.isinf(mesh_depth((corners + place)[None], SHAPES[0].faces, CAMERA, 0.05)).all()


def test_neighbouring_triangles_leave_no_gap():
    # Edges of a plane grid through pixels' centres.
    camera = Camera(16, 16, torch.tensor([16.0, 16.0, 8.5, 8.5], dtype=torch.float64))
    x, y = np.meshgrid(np.linspace(-1, 1, 17), np.linspace(-1, 1, 17))
    corners = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1)
    first = (np.arange(16)[:, None] * 17 + np.arange(16)).ravel()
    faces = np.concatenate([np.stack([first, first + 1, first + 18], 1), np.stack([first, first + 18, first + 17], 1)])
    np.testing.assert_array_equal(mesh_depth(corners[None], faces, camera), np.ones((1, 16, 16)))


@pytest.mark.parametrize(
    ("corners", "faces", "near", "message"),
    [
        (np.zeros((4, 3)), np.zeros((1, 3), int), 0.1, r"vertices, faces are \(4, 3\), \(1, 3\)"),
        (np.zeros((1, 4, 3)), np.zeros((1, 4), int), 0.1, r"allowed: \(V, n, 3\), \(m, 3\)"),
        (np.zeros((1, 4, 3)), np.array([[0, 1, 4]]), 0.1, "faces name corners 0 to 4; allowed: 0 to 3"),
        (np.zeros((1, 4, 3)), np.array([[0, 1, 3]]), 0.0, "near is 0.0; allowed: above 0 m"),
    ],
)
def test_what_does_not_fit_is_refused(corners, faces, near, message):
    with pytest.raises(RenderingError, match=message):
        mesh_depth(corners, faces, CAMERA, near)
