# SPDX-License-Identifier: MIT
import json
import math
import os
import re

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from pinwm_drake.capture.scene import read_capture_object
from pinwm_drake.capture.static_views import read_views, winding_number
from pinwm_drake.errors import InputError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.spatial.poses import Pose
from tests.capture.cube import CAPTURE, HEIGHT, SIDE, cameras, read_static_views, write_capture, write_views


@pytest.fixture
def capture(tmp_path):
    return write_capture(tmp_path / "capture", count=3)


def edit(capture, change):
    """Changes the transforms of a capture."""
    path = capture / "static/transforms.json"
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))
    return path


def refused(capture, *parts):
    """The message with which a capture is refused; it holds all the parts."""
    with pytest.raises(InputError) as caught:
        read_static_views(capture)
    for part in parts:
        assert str(part) in f"{caught.value.path} {caught.value}"  # a long message has only the end of the path
    assert "\n" not in str(caught.value)


def test_the_object_is_read(capture):
    about = read_capture_object(capture)
    assert (about.name, about.mesh_path) == ("cube", capture / "meshes/object.obj")
    assert about.X_WO.p.tolist() == [0, 0, HEIGHT]
    assert about.X_WO.q.tolist() == [1, 0, 0, 0]


@pytest.mark.parametrize("alpha", [True, False])
def test_views_show_the_object_where_its_mesh_is(tmp_path, alpha):
    views = read_static_views(write_capture(tmp_path / "capture", alpha=alpha))
    corners = torch.tensor(load_mesh(tmp_path / "capture/meshes/object.obj").vertices)
    for view, camera in zip(views, cameras(48, 8), strict=True):
        at, depths = view.project(corners)
        expected, expected_depths = camera.project(corners.numpy() + np.array([0, 0, HEIGHT]))
        np.testing.assert_allclose(at, expected, atol=1e-9)
        np.testing.assert_allclose(depths, expected_depths, atol=1e-12)
        rows, columns = np.nonzero(view.mask.numpy())
        # A pixel counts where half of it is covered.
        assert columns.min() == pytest.approx(math.floor(at[:, 0].min()), abs=1)
        assert columns.max() == pytest.approx(math.floor(at[:, 0].max()), abs=1)
        assert rows.min() == pytest.approx(math.floor(at[:, 1].min()), abs=1)
        assert rows.max() == pytest.approx(math.floor(at[:, 1].max()), abs=1)
        assert (view.image[~view.mask] == 1).all()
        assert view.image.dtype == torch.float32
        # The middle of the picture lies on the nearest vertical edge or face, never on white.
        assert view.image[24, 24].min() < 0.95


def test_alpha_and_white_say_the_same(tmp_path):
    with_alpha = read_views(write_views(tmp_path / "a", count=2))
    on_white = read_views(write_views(tmp_path / "b", count=2, alpha=False))
    for one, other in zip(with_alpha, on_white, strict=True):
        # A pixel of the outline that is about half covered may count in one and not in the other.
        same = one.mask == other.mask
        assert same.float().mean() > 0.998
        # One rounding to 8 bits.
        np.testing.assert_allclose(one.image[same], other.image[same], atol=0.51 / 255)


def test_a_bare_folder_and_its_file_are_read(tmp_path):
    folder = write_views(tmp_path / "views", count=2)
    X_WO = Pose(torch.tensor([0.0, 0, 0, 1], dtype=torch.float64), torch.tensor([0, 0, HEIGHT], dtype=torch.float64))
    for path in (folder, folder / "transforms.json"):
        view = read_views(path, X_WO)[0]
        # Half a turn about z: the point on the left of the object is on the right in the world.
        at, _ = view.project(torch.tensor([[0.02, 0.01, 0.03]]))
        expected, _ = cameras(48, 2)[0].project(np.array([[-0.02, -0.01, 0.03 + HEIGHT]]))
        np.testing.assert_allclose(at, expected, atol=1e-6)


def test_a_mask_replaces_alpha(capture):
    (capture / "static/masks").mkdir()
    for k in range(3):
        mask = np.zeros((48, 48), np.uint8)
        mask[20:30, 20 + k : 30] = 255
        Image.fromarray(mask).save(capture / f"static/masks/{k:03}.png")
    for k, view in enumerate(read_static_views(capture)):
        assert view.mask.sum() == 10 * (10 - k)
        assert (view.image[~view.mask] == 1).all()
        assert view.image[25, 25].min() < 0.95
    os.remove(capture / "static/masks/001.png")
    refused(capture, "static/masks", "no mask 001.*", "a mask for each image")
    Image.fromarray(mask[:40]).save(capture / "static/masks/001.png")
    refused(capture, "masks/001.png", "48 x 40 px", "48 x 48 px")


def test_intrinsics_of_a_frame_come_before_those_of_the_file(capture):
    edit(capture, lambda data: data["frames"][1].update(fl_x=100.0, cx=20.0))
    intrinsics = [view.camera.intrinsics.tolist() for view in read_static_views(capture)]
    assert intrinsics[1][0] == 100
    assert intrinsics[1][2] == 20
    assert intrinsics[0] == intrinsics[2] != intrinsics[1]


def matrix(document, row, column, value):
    """Changes the pose of the second frame."""
    document["frames"][1]["transform_matrix"][row][column] = value


def place(document, *position):
    for row, value in enumerate(position):
        matrix(document, row, 3, value)


def flip(document, *columns):
    for row in document["frames"][1]["transform_matrix"][:3]:
        for column in columns:
            row[column] = -row[column]


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda d: d.pop("fl_x"), ["no fl_x", "a value under fl_x"]),
        (lambda d: d.pop("frames"), ["no frames"]),
        (lambda d: d["frames"].clear(), ["frames = []", "one entry or more"]),
        (lambda d: d["frames"][1].pop("file_path"), ["no frames[1].file_path"]),
        (lambda d: d["frames"][2].pop("transform_matrix"), ["no frames[2].transform_matrix"]),
        (lambda d: d.update(fl_x=float("nan")), ["fl_x = NaN", "finite"]),
        (lambda d: d.update(fl_y=-3), ["fl_y = -3", "0.001"]),
        (lambda d: d.update(w=0), ["w = 0", "whole number from 1"]),
        (lambda d: d.update(w=True), ["w = true"]),
        (lambda d: d.update(cx="24"), ['cx = "24"', "finite number"]),
        (lambda d: d.update(fl_x=10**400), ["fl_x = 1000", "finite number"]),
        (lambda d: d.update(camera_model="OPENCV_FISHEYE"), ["camera_model", "OPENCV_FISHEYE", "PINHOLE"]),
        (lambda d: d["frames"][0].update(k1=0.01), ["frames[0].k1 = 0.01", "undistort"]),
        (lambda d: matrix(d, 0, 3, float("inf")), ["frames[1].transform_matrix[0][3]", "finite"]),
        (lambda d: d["frames"][1]["transform_matrix"].pop(), ["frames[1].transform_matrix", "4 x 4 finite numbers"]),
        (lambda d: matrix(d, 3, 0, 0.1), ["frames[1].transform_matrix", "last row"]),
        (lambda d: matrix(d, 0, 0, 2.0), ["frames[1].transform_matrix", "rigid"]),
        (lambda d: flip(d, 0), ["frames[1].transform_matrix", "a reflection"]),
        (lambda d: d["frames"][1].update(file_path="images/000.png"), ["frames[1].file_path", "frames[0] too"]),
        (lambda d: d["frames"][1].update(file_path="images/9.png"), ["images/9.png", "no such file"]),
        (lambda d: d.update(w=64), ["images/000.png", "48 x 48 px", "64 x 48 px", "frames[0]"]),
        (lambda d: place(d, 0, 0, HEIGHT), ["frames[1].transform_matrix", "inside the object", "[0.0, 0.0, 0.0]"]),
        # OpenCV's axes instead of OpenGL's.
        (lambda d: flip(d, 1, 2), ["frames[1].transform_matrix", "looks away", "OpenGL"]),
        (lambda d: matrix(d, 2, 3, 2.0), ["frames[1].transform_matrix", "rows", "001.png"]),
    ],
)
def test_wrong_transforms_are_refused(capture, change, parts):
    path = edit(capture, change)
    refused(capture, path.parent, *parts)


def save(capture, pixels, **options):
    Image.fromarray(pixels).save(capture / "static/images/001.png", **options)


def truncate(path):
    path.write_bytes(path.read_bytes()[:-200])


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda c: truncate(c / "static/images/001.png"), ["unreadable contents", "truncated"]),
        (lambda c: (c / "static/images/001.png").write_bytes(b""), ["no image"]),
        (lambda c: (c / "static/images/001.png").write_text("hello"), ["no image"]),
        (lambda c: save(c, np.zeros((48, 48, 4), np.uint8)), ["no pixel of the object"]),
        (lambda c: save(c, np.full((48, 48, 3), 255, np.uint8)), ["no pixel of the object"]),
        (lambda c: save(c, np.full((48, 48, 3), 90, np.uint8)), ["no white pixel", "masks/"]),
        (lambda c: save(c, np.full((48, 40, 4), 200, np.uint8)), ["40 x 48 px"]),
        (lambda c: save(c, np.zeros((48, 48), np.uint16)), ["mode I;16"]),
    ],
)
def test_wrong_images_are_refused(capture, change, parts):
    change(capture)
    refused(capture, capture / "static/images/001.png", *parts)


def rewrite(old, new):
    return lambda c: (c / "capture.yaml").write_text(CAPTURE.replace(old, new))


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (rewrite("schema_version: 1", "schema_version: 2"), ["schema_version = 2", "allowed: 1"]),
        (rewrite("schema_version: 1", ""), ["no schema_version"]),
        (rewrite("length: m", "length: mm"), ['units.length = "mm"', "allowed: m"]),
        (rewrite("meshes/object.obj", "meshes/nothing.obj"), ["meshes/nothing.obj", "no such file"]),
        (rewrite("  mesh: meshes/object.obj\n", ""), ["no object.mesh"]),
        (rewrite("q: [1.0,", "q: [1.1,"), ["object.X_WO.q", "norm 1.1"]),
        (rewrite("p: [0.0,", "p: [.nan,"), ["object.X_WO.p[0] = NaN"]),
        (rewrite("p: [0.0, 0.0,", "p: [0.0,"), ["object.X_WO.p", "3 finite numbers"]),
        (rewrite("gravity: 9.8", "gravity: [9.8"), ["row", "YAML"]),
        (rewrite("schema_version: 1", "- 1"), ["YAML"]),
        (lambda c: (c / "capture.yaml").write_text("hello"), ["a mapping"]),
        (lambda c: (c / "capture.yaml").write_text("a: !!python/object/apply:os.getpid []"), ["YAML"]),
        (lambda c: (c / "capture.yaml").write_bytes(b"\xff\xfe\xfa"), ["UTF-8"]),
        (lambda c: (c / "capture.yaml").unlink(), ["no such file"]),
    ],
)
def test_a_wrong_capture_file_is_refused(capture, change, parts):
    change(capture)
    refused(capture, "capture.yaml" if "meshes" not in parts[0] else parts[0], *parts)


def test_json_errors_name_the_line(capture):
    path = capture / "static/transforms.json"
    path.write_text('{\n "w": 48,\n "h": \n}')
    refused(capture, path, "row 4", "allowed: JSON")
    path.write_text("[" * 100000)
    refused(capture, path, "allowed: JSON")
    path.unlink()
    refused(capture, path, "no such file")


def test_wrong_meshes_are_refused(capture):
    path = capture / "meshes/object.obj"
    ball = trimesh.creation.icosphere(subdivisions=1, radius=SIDE)
    ball.update_faces(ball.triangles_center[:, 2] < 0.5 * SIDE)
    ball.export(path)
    refused(capture, path, "an open surface", "watertight")
    path.write_text("")
    refused(capture, path)


def test_the_winding_number_tells_inside_from_outside():
    mesh = trimesh.creation.torus(0.05, 0.01)
    assert winding_number(mesh, np.array([0.05, 0, 0])) == pytest.approx(1)
    assert winding_number(mesh, np.array([0.0, 0, 0])) == pytest.approx(0, abs=1e-9)
    assert winding_number(mesh, np.array([0.05, 0, 0.011])) == pytest.approx(0, abs=1e-9)


def test_a_released_capture_is_read(shared):
    folder = shared / "data/pinwm_push_t"
    views = read_static_views(folder)
    mesh = load_mesh(folder / "meshes/object.obj")
    assert len(views) == 12
    for view in views:
        at, _ = view.project(torch.tensor(mesh.vertices))
        rows, columns = np.nonzero(view.mask.numpy())
        # Their Bullet draws edges about a pixel wider.
        np.testing.assert_allclose(at.amin(0), [columns.min(), rows.min()], atol=2)
        np.testing.assert_allclose(at.amax(0), [columns.max() + 1, rows.max() + 1], atol=2)


def test_messages_repeat_no_more_than_the_start_of_a_value(capture):
    edit(capture, lambda data: data.update(frames="x" * 1000))
    with pytest.raises(InputError) as caught:
        read_static_views(capture)
    assert len(re.findall("x+", str(caught.value))[-1]) < 100


def write_masks(capture, *names, size=48):
    """Writes masks with 10 rows of white more from one to the next."""
    for k, name in enumerate(names):
        path = capture / "static/masks" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        mask = np.zeros((size, size), np.uint8)
        mask[18 : 20 + 4 * k, 10:40] = 255
        Image.fromarray(mask).save(path)


def rows(view):
    return int(view.mask.any(dim=1).sum())


def rename(capture, *names):
    """Renames the images."""

    def change(data):
        for frame, name in zip(data["frames"], names, strict=True):
            (capture / "static" / name).parent.mkdir(parents=True, exist_ok=True)
            (capture / "static" / frame["file_path"]).rename(capture / "static" / name)
            frame["file_path"] = name

    edit(capture, change)


def test_the_exact_name_of_a_mask_comes_first(capture):
    rename(capture, "images/view.png", "images/view.2.png", "images/view.2.b.png")
    write_masks(capture, "view.png", "view.2.png", "view.2.b.png")
    assert [rows(view) for view in read_static_views(capture)] == [2, 6, 10]


@pytest.mark.parametrize("names", [("a.jpg.png", "b.png", "c.png.png"), ("a.PNG", "b.png", "c.jpg")])
def test_other_names_of_a_mask(capture, names):
    rename(capture, "images/a.jpg", "images/b.png", "images/c.png")
    write_masks(capture, *(name.replace("PNG", "png") for name in names))
    for name in {name for name in names if name.endswith("PNG")}:
        (capture / "static/masks" / name.replace("PNG", "png")).rename(capture / "static/masks" / name)
    assert [rows(view) for view in read_static_views(capture)] == [2, 6, 10]


def test_folders_of_masks_mirror_those_of_the_images(capture):
    rename(capture, "images/cam1/a.png", "images/cam2/a.png", "images/cam2/deep/a.png")
    write_masks(capture, "cam1/a.png", "cam2/a.png", "cam2/deep/a.png")
    assert [rows(view) for view in read_static_views(capture)] == [2, 6, 10]
    os.remove(capture / "static/masks/cam2/a.png")
    write_masks(capture, "a.png")
    refused(capture, "no mask cam2/a.*")


def test_ambiguous_masks_are_refused_with_both_names(capture):
    rename(capture, "images/a.jpg", "images/b.png", "images/c.png")
    write_masks(capture, "a.png", "b.png", "c.png", "a.bmp")
    refused(capture, "a.bmp", "a.png")
    os.remove(capture / "static/masks/a.bmp")
    write_masks(capture, "a.png", "b.png", "c.png", "b.png.png")
    refused(capture, "b.png: ", "b.png.png beside it")
    os.remove(capture / "static/masks/b.png.png")
    rename(capture, "images/c.jpg", "images/b.png", "images/c.png")
    os.remove(capture / "static/masks/a.png")
    refused(capture, "c.png", "a mask of c.jpg or of c.png", "c.jpg.png")


def test_only_pictures_are_masks(capture):
    folder = capture / "static/masks"
    folder.mkdir()
    for name in ("000.txt", ".DS_Store", "Thumbs.db", "._000.png", "000.json"):
        (folder / name).write_text("hello")
    # Without a picture in it, the folder says nothing: alpha does.
    expected = read_views(write_views(capture.with_name("other"), count=3))
    assert all(torch.equal(a.mask, b.mask) for a, b in zip(read_static_views(capture), expected, strict=True))
    write_masks(capture, "000.png", "001.png", "002.png")
    assert [rows(view) for view in read_static_views(capture)] == [2, 6, 10]


@pytest.mark.parametrize(
    ("keys", "part"),
    [
        ({"is_fisheye": True}, "is_fisheye = true"),
        ({"distortion_params": [0, 0, 0.1, 0, 0, 0]}, "distortion_params"),
        ({"k5": 0.2}, "k5 = 0.2"),
        ({"p2": -0.01}, "p2 = -0.01"),
        ({"rolling_shutter": [0, 0, 0.1]}, "rolling_shutter"),
        ({"camera_model": "EQUIRECTANGULAR"}, "EQUIRECTANGULAR"),
        ({"camera_angle_y": 0.9}, "camera_angle_y = 0.9"),
        ({"camera_angle_x": 25.0}, "are these degrees? 0.4363 rad"),
        ({"scale": 0.33}, "scale = 0.33"),
        ({"offset": [0.5, 0.5, 0.5]}, "offset"),
        ({"fov_vertical": 40.0}, "an unknown key 'fov_vertical'"),
        ({"vignetting": {"a": 1}}, "an unknown key 'vignetting'"),
    ],
)
@pytest.mark.parametrize("in_frame", [False, True])
def test_keys_of_cameras_that_are_not_obeyed_are_refused_by_name(capture, keys, part, in_frame):
    edit(capture, lambda d: (d["frames"][1] if in_frame else d).update(keys))
    refused(capture, "transforms.json", part)


def test_keys_that_change_nothing_are_read(capture):
    expected = read_static_views(capture)
    angle = math.radians(25.0)
    keys = {
        "is_fisheye": False,
        "k1": 0.0,
        "distortion_params": [0.0] * 6,
        "aabb_scale": 16,
        "scale": 1,
        "offset": [0] * 3,
    }
    keys |= {"camera_angle_x": angle, "camera_angle_y": angle, "ply_file_path": "a.ply", "k2": None}
    edit(capture, lambda d: [d.update(keys), d["frames"][0].update(sharpness=3.5, colmap_im_id=4)])
    for one, other in zip(read_static_views(capture), expected, strict=True):
        assert one.camera.intrinsics.tolist() == other.camera.intrinsics.tolist()


def test_a_world_that_nerfstudio_has_moved_is_told(capture):
    edit(capture, lambda d: d.update(applied_transform=np.eye(4)[:3].tolist()))
    with pytest.warns(UserWarning, match="applied_transform is not undone"):
        read_static_views(capture)


def test_one_image_by_two_names_is_refused(capture):
    edit(capture, lambda d: d["frames"][1].update(file_path="images/../images/000.png"))
    refused(capture, "frames[1].file_path", "frames[0] too")
