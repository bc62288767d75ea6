# SPDX-License-Identifier: MIT
import pytest
import torch
import trimesh

from pinwm_drake.rendering.camera import Camera, zoomed
from pinwm_drake.rendering.silhouette import silhouette
from pinwm_drake.rendering.views import project
from pinwm_drake.spatial.poses import Pose
from tests.rendering.scenes import camera

AHEAD = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)


def pixels(view, points):
    return project(view, Pose(AHEAD, torch.zeros(3, dtype=torch.float64)), points)[0]


def points(number=9, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(number, 3, generator=generator, dtype=torch.float64) + torch.tensor([-0.5, -0.5, 1.0])


def test_a_shifted_camera_sees_everything_elsewhere():
    view, p_C = camera(), points()
    moved = view.shifted((2.5, -1.0))
    assert (moved.width, moved.height) == (view.width, view.height)
    assert torch.allclose(pixels(moved, p_C) - pixels(view, p_C), torch.tensor([2.5, -1.0]).double())
    several = Camera(view.width, view.height, view.intrinsics.expand(3, 4)).shifted((2.5, -1.0))
    assert torch.equal(several.intrinsics, moved.intrinsics.expand(3, 4))


def test_zoomed_intrinsics_enlarge_about_a_point():
    view, p_C, about = camera(), points(), torch.tensor([11.0, 7.5], dtype=torch.float64)
    scale = torch.tensor([0.9, 1.0, 1.3], dtype=torch.float64)
    found = zoomed(view.intrinsics, scale, about)
    assert found.shape == (3, 4)
    for factor, intrinsics in zip(scale, found, strict=True):
        larger = pixels(Camera(view.width, view.height, intrinsics), p_C)
        assert torch.allclose(larger, about + factor * (pixels(view, p_C) - about))


@pytest.mark.parametrize(("z", "seen"), [(0.5, True), (0.03, False), (0.0, False), (-0.5, False)])
def test_a_silhouette_needs_all_of_the_mesh_in_front(z, seen):
    cube = trimesh.creation.box((0.06, 0.06, 0.06))
    view = Camera(40, 30, torch.tensor([50.0, 50.0, 20.0, 15.0], dtype=torch.float64))
    found = silhouette(cube, view, Pose(AHEAD, torch.tensor([0.0, 0.0, z], dtype=torch.float64)))
    assert (found is not None) == seen
    if found is not None:
        # The front face, 60 mm wide at 470 mm: 6.4 px, of which six centres lie inside.
        assert (found.shape, found.dtype, found.sum()) == ((30, 40), bool, 36)
