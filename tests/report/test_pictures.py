# SPDX-License-Identifier: MIT
import dataclasses
import math

import cv2
import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.report.captions import write_caption
from pinwm_drake.report.scene import Actor, Paint, Stage, Surface, draw_triangles
from pinwm_drake.report.video import write_video
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import matrix_to_quaternion

RED, BLUE = (0.8, 0.05, 0.05), (0.05, 0.05, 0.8)


def view(width: int = 160, height: int = 90) -> ViewCamera:
    return ViewCamera.look_at(np.array([1.0, 0.0, 1.0]), np.zeros(3), width=width, height=height, field_of_view=0.5)


def test_the_camera_sees_its_target_in_the_middle_and_up_as_up():
    camera = view()
    pixels, depths = camera.project(np.array([[0.0, 0, 0], [0, 0, 0.1], [0, 0.1, 0]]))
    np.testing.assert_allclose(pixels[0], [80, 45], atol=1e-9)
    assert depths[0] == pytest.approx(math.sqrt(2))
    assert pixels[1, 1] < 45  # up in the world is up in the picture
    assert pixels[2, 0] > 80  # looking along -x, +y is on the right
    assert np.linalg.det(camera.R_WC) == pytest.approx(1)


def test_rays_and_projection_are_inverse():
    camera = view()
    points = camera.p_WC + 2.0 * camera.rays()[::30, ::40].reshape(-1, 3)
    pixels, _ = camera.project(points)
    x, y = np.meshgrid(np.arange(0, 160, 40) + 0.5, np.arange(0, 90, 30) + 0.5)
    np.testing.assert_allclose(pixels, np.column_stack((x.ravel(), y.ravel())), atol=1e-9)


def test_a_ball_covers_its_cone_of_sight():
    # A ball of radius r at distance d on the optical axis shows a disc of radius f r / sqrt(d² - r²).
    camera = view(640, 360)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    surface = Surface.empty(camera)
    draw_triangles(surface, camera, *Actor.from_mesh(ball, RED, smooth=True).at(np.eye(3), np.zeros(3)), RED)
    expected = math.pi * (camera.focal * 0.1) ** 2 / (2 - 0.1**2)
    # The polyhedron lies up to 0.3 % inside the ball, and its edge cuts pixels.
    assert (surface.inverse_depth > 0).sum() == pytest.approx(expected, rel=0.01)
    assert 1 / surface.inverse_depth[180, 320] == pytest.approx(math.sqrt(2) - 0.1, rel=0.01)
    toward_camera = camera.p_WC / np.linalg.norm(camera.p_WC)
    np.testing.assert_allclose(surface.normal[180, 320], toward_camera, atol=0.03)


def test_the_nearer_body_hides_the_other_in_either_order():
    camera = view()
    cube = trimesh.creation.box((0.2, 0.2, 0.2))
    towards = 0.3 * camera.p_WC / np.linalg.norm(camera.p_WC)
    bodies = [(RED, towards), (BLUE, np.zeros(3))]
    for order in (bodies, bodies[::-1]):
        surface = Surface.empty(camera)
        for colour, p_WB in order:
            corners, normals = Actor.from_mesh(cube, colour, smooth=False).at(np.eye(3), p_WB)
            draw_triangles(surface, camera, corners, normals, np.array(colour))
        np.testing.assert_allclose(surface.colour[45, 80], RED, atol=1e-6)


def test_a_painted_body_has_the_colours_of_the_nearest_samples():
    camera = view(320, 180)
    cube = trimesh.creation.box((0.2, 0.2, 0.2))
    # Red on top, blue aside; a green sample beside each, of the other side of a wall, does not count.
    points, faces = trimesh.sample.sample_surface(cube, 40000, seed=0)
    normals = cube.face_normals[faces]
    colours = np.where(normals[:, 2:] > 0.5, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    green = np.tile([0.0, 1.0, 0.0], (len(points), 1))
    paint = Paint(np.tile(points, (2, 1)), np.concatenate((normals, -normals)), np.concatenate((colours, green)))
    actor = dataclasses.replace(Actor.from_mesh(cube, RED, smooth=False), paint=paint)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for R_WB in (np.eye(3), turn):
        surface = Surface.of(camera, [(actor, R_WB, np.array([0.0, 0.0, -0.1]))])
        top = (surface.owner == 0) & (surface.normal[..., 2] > 0.9)
        aside = (surface.owner == 0) & (surface.normal[..., 0] > 0.9)
        assert min(top.sum(), aside.sum()) > 50
        np.testing.assert_allclose(np.median(surface.colour[top], axis=0), [1, 0, 0], atol=1e-6)
        np.testing.assert_allclose(np.median(surface.colour[aside], axis=0), [0, 0, 1], atol=1e-6)
        assert not surface.colour[..., 1].any()


def test_a_camera_of_a_capture_projects_as_its_intrinsics_say():
    camera = Camera(60, 40, torch.tensor([50.0, 55.0, 28.0, 21.0], dtype=torch.float64))
    looks = view()
    pose = Pose(matrix_to_quaternion(torch.from_numpy(looks.R_WC)), torch.from_numpy(looks.p_WC))
    found = ViewCamera.of(camera, pose)
    p_C = np.array([[0.1, -0.05, 0.8], [0.0, 0.0, 2.0]])
    p_W = p_C @ looks.R_WC.T + looks.p_WC
    pixels, depths = found.project(p_W)
    np.testing.assert_allclose(pixels, p_C[:, :2] / p_C[:, 2:] * [50, 55] + [28, 21], atol=1e-9)
    np.testing.assert_allclose(depths, p_C[:, 2])
    np.testing.assert_allclose(found.scaled(2).project(p_W)[0], 2 * pixels, atol=1e-9)
    # Points and rays are inverse to that.
    shown = np.zeros((40, 60), bool)
    shown[10, 50] = True
    there = found.points(np.array([1.5]), shown)
    np.testing.assert_allclose(found.project(there)[0], [[50.5, 10.5]], atol=1e-9)
    np.testing.assert_allclose(found.project(found.p_WC + found.rays()[10:11, 50])[0], [[50.5, 10.5]], atol=1e-9)


def test_a_picture_shows_body_shadow_and_path():
    stage = Stage(view())
    cube = trimesh.creation.box((0.1, 0.1, 0.1))
    empty = stage.picture([], []).astype(int)
    pose = (np.eye(3), np.array([0, 0, 0.05]))
    body = stage.picture([(Actor.from_mesh(cube, RED, smooth=False), *pose)], []).astype(int)
    assert body[45, 80, 0] > body[45, 80, 2] + 50
    shadow = (body.sum(axis=2) < empty.sum(axis=2) - 60) & (np.ptp(body, axis=2) < 30)
    assert shadow.sum() > 50
    line = stage.picture([], [(np.array([[0.0, -0.2], [0.0, 0.2]]), BLUE)]).astype(int)
    assert line[45, 80, 2] > line[45, 80, 0] + 50


def test_a_caption_changes_the_lower_left_corner_only():
    image = np.full((270, 480, 3), 255, np.uint8)
    write_caption(image, "0.50 s")
    rows, columns = np.nonzero(image.min(axis=2) < 128)
    assert len(rows) > 20
    assert rows.min() > 240
    assert columns.max() < 240


def test_a_video_can_be_read_back(tmp_path):
    path = tmp_path / "a.mp4"
    frames = [np.full((90, 160, 3), (30 * k, 20, 20), np.uint8) for k in range(8)]
    write_video(path, iter(frames), rate=30.0, size=(160, 90))
    reader = cv2.VideoCapture(str(path))
    assert reader.get(cv2.CAP_PROP_FPS) == pytest.approx(30)
    read = []
    while (step := reader.read())[0]:
        read.append(step[1])
    assert len(read) == 8
    # A lossy codec in limited-range YUV: a few grey levels.
    assert abs(int(read[7][45, 80, 2]) - 210) < 10
    assert [name.name for name in tmp_path.iterdir()] == ["a.mp4"]


def test_a_video_that_cannot_be_written_is_refused(tmp_path, capfd):
    with pytest.raises(InputError, match=r"a\.mp4"):
        write_video(tmp_path / "missing/a.mp4", iter([]), rate=30.0, size=(160, 90))
