# SPDX-License-Identifier: MIT
"""Scans by a lens with distortion become captures of pinholes, by either importer."""

import json
import shutil

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from pinwm_drake.capture.importers.colmap import import_colmap, read_model
from pinwm_drake.capture.importers.lenses import COLMAP_MODELS
from pinwm_drake.capture.importers.nerfstudio import import_nerfstudio
from pinwm_drake.capture.importers.target import Scenery
from pinwm_drake.capture.lens import Lens
from pinwm_drake.capture.static_views import read_views
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.rotations import quaternion_to_matrix
from tests.capture.cube import read_static_views, write_mesh, write_views
from tests.capture.pushed_cube import X_WO
from tests.capture.test_colmap import IDENTITY, WRITERS, model_of

SIZE = 160
KEYS = {"opencv": ("k1", "k2", "p1", "p2", "k3"), "fisheye": ("k1", "k2", "k3", "k4")}
NUMBERS = {"opencv": [-0.3, 0.12, 0.004, -0.003, 0.0], "fisheye": [0.05, -0.02, 0.01, 0.0]}
MODELS = {"opencv": "OPENCV", "fisheye": "OPENCV_FISHEYE"}


def as_seen_by(lens, image, fill):
    """Image of a pinhole with the lens's intrinsics as the lens would have taken it."""
    x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    rays = lens.rays(np.column_stack([x.ravel(), y.ravel()]))
    where = (rays * lens.intrinsics[:2] + lens.intrinsics[2:] - 0.5).reshape(SIZE, SIZE, 2).astype(np.float32)
    return cv2.remap(image, where, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=(fill,) * 4)


@pytest.fixture(scope="module", params=["opencv", "fisheye"])
def whole(tmp_path_factory, request):
    """A scan by a lens, its views before, the lens, and the images of a COLMAP model."""
    folder = write_views(tmp_path_factory.mktemp("lens") / "scan", size=SIZE, count=8)
    before, images = read_views(folder, X_WO()), model_of(folder)[1]
    document = json.loads((folder / "transforms.json").read_text())
    intrinsics = np.array([document[key] for key in ("fl_x", "fl_y", "cx", "cy")])
    lens = Lens(SIZE, SIZE, request.param, intrinsics, np.array(NUMBERS[request.param]))
    for path in sorted((folder / "images").glob("*.png")):
        Image.fromarray(as_seen_by(lens, np.array(Image.open(path).convert("RGBA")), 0)).save(path)
    document |= {"camera_model": MODELS[lens.model], **dict(zip(KEYS[lens.model], lens.distortion, strict=True))}
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder, before, lens, images


@pytest.fixture
def scan(whole, tmp_path):
    """A copy of it, to be changed."""
    folder, *rest = whole
    return shutil.copytree(folder, tmp_path / "scan"), *rest


@pytest.fixture
def scenery(tmp_path):
    return Scenery("cube", write_mesh(tmp_path / "cube.obj"), X_WO())


def same(found, before):
    assert len(found) == len(before)
    for one, other in zip(found, before, strict=True):
        # The cube is in the middle of each image, so that no focal length had to give way.
        torch.testing.assert_close(one.camera.intrinsics, other.camera.intrinsics, rtol=0, atol=1e-9)
        torch.testing.assert_close(quaternion_to_matrix(one.X_CO.q), quaternion_to_matrix(other.X_CO.q))
        both, either = (one.mask & other.mask).sum(), (one.mask | other.mask).sum()
        assert float(both / either) > 0.985  # twice resampled: an outline may be off by a third of a pixel
        inner = torch.from_numpy(cv2.erode((one.mask & other.mask).numpy().astype(np.uint8), np.ones((5, 5)))) > 0
        assert float((one.image - other.image)[inner].abs().mean()) < 0.02


def test_a_distorted_scan_is_another_one(scan):
    _, before, lens, _ = scan
    rays = (np.array([[0.5, 0.5]]) - lens.intrinsics[2:]) / lens.intrinsics[:2]
    assert np.linalg.norm(lens.project(np.array([[*rays[0], 1.0]]))[0] - 0.5) > 1.0  # px in the corner
    assert len(before) == 8


@pytest.mark.parametrize("of", ["alpha", "masks", "white"])
def test_a_nerfstudio_scan_is_undistorted(scan, scenery, tmp_path, of):
    folder, before, _, _ = scan
    if of != "alpha":
        (folder / "masks").mkdir()
    for path in sorted((folder / "images").glob("*.png")) if of != "alpha" else []:
        pixels = Image.open(path)
        if of == "masks":
            pixels.getchannel("A").point(lambda alpha: 255 * (alpha > 127)).save(folder / "masks" / path.name)
            pixels.convert("RGB").save(path)
        else:
            white = Image.new("RGBA", pixels.size, (255, 255, 255, 255))
            white.alpha_composite(pixels)
            white.convert("RGB").save(path)
    import_nerfstudio(folder, tmp_path / "out", scenery)
    same(read_static_views(tmp_path / "out"), before)
    document = json.loads((tmp_path / "out/static/transforms.json").read_text())
    assert document["camera_model"] == "PINHOLE"


def test_a_frame_may_have_a_lens_of_its_own(scan, scenery, tmp_path):
    folder, before, lens, _ = scan
    document = json.loads((folder / "transforms.json").read_text())
    for frame in document["frames"]:
        frame |= {key: document[key] for key in KEYS[lens.model]}
    for key in KEYS[lens.model]:
        document[key] = 0.0
    (folder / "transforms.json").write_text(json.dumps(document))
    import_nerfstudio(folder, tmp_path / "out", scenery)
    same(read_static_views(tmp_path / "out"), before)


def test_the_old_key_of_a_fisheye_is_obeyed(scan, scenery, tmp_path):
    folder, before, lens, _ = scan
    document = json.loads((folder / "transforms.json").read_text())
    document.pop("camera_model")
    document["is_fisheye"] = lens.model == "fisheye"
    (folder / "transforms.json").write_text(json.dumps(document))
    import_nerfstudio(folder, tmp_path / "out", scenery)
    same(read_static_views(tmp_path / "out"), before)


@pytest.mark.parametrize("kind", WRITERS)
def test_a_colmap_scan_is_undistorted(scan, scenery, tmp_path, kind):
    folder, before, lens, images = scan
    fx, fy, cx, cy = lens.intrinsics
    camera = (MODELS[lens.model], SIZE, SIZE, [float(value) for value in (fx, fy, cx, cy, *lens.distortion[:4])])
    WRITERS[kind](tmp_path / "model", {3: camera, 7: camera}, images)
    import_colmap(tmp_path / "model", tmp_path / "out", scenery, IDENTITY, images=folder / "images")
    same(read_static_views(tmp_path / "out"), before)


@pytest.mark.parametrize(
    ("model", "parameters", "lens_model", "distortion"),
    [
        ("SIMPLE_RADIAL", [50, 24, 25, 0.1], "opencv", [0.1, 0, 0, 0, 0]),
        ("RADIAL", [50, 24, 25, 0.1, 0.2], "opencv", [0.1, 0.2, 0, 0, 0]),
        ("OPENCV", [50, 51, 24, 25, 0.1, 0.2, 0.3, 0.4], "opencv", [0.1, 0.2, 0.3, 0.4, 0]),
        ("OPENCV_FISHEYE", [50, 51, 24, 25, 0.1, 0.2, 0.3, 0.4], "fisheye", [0.1, 0.2, 0.3, 0.4]),
        ("SIMPLE_RADIAL_FISHEYE", [50, 24, 25, 0.1], "fisheye", [0.1, 0, 0, 0]),
        ("RADIAL_FISHEYE", [50, 24, 25, 0.1, 0.2], "fisheye", [0.1, 0.2, 0, 0]),
        (
            "FULL_OPENCV",
            [50, 51, 24, 25, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8],
            "opencv",
            [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8],
        ),
    ],
)
@pytest.mark.parametrize("kind", WRITERS)
def test_every_lens_of_colmap_is_read(tmp_path, kind, model, parameters, lens_model, distortion):
    writer = WRITERS[kind]
    write_views(tmp_path / "scan", size=48, count=8)
    _, images = model_of(tmp_path / "scan")
    camera = (model, 48, 48, [float(value) for value in parameters])
    writer(tmp_path / "model", {3: camera, 7: camera}, images)
    lens = read_model(tmp_path / "model")[0].lens
    assert lens is not None
    assert lens.model == lens_model
    np.testing.assert_allclose(lens.distortion, distortion)
    assert lens.intrinsics.tolist() == [50.0, parameters[1] if parameters[1] > 30 else 50.0, 24.0, 25.0]


def test_a_lens_without_distortion_is_a_pinhole(tmp_path):
    write_views(tmp_path / "scan", size=48, count=8)
    _, images = model_of(tmp_path / "scan")
    camera = ("OPENCV", 48, 48, [50.0, 51.0, 24.0, 25.0, 0.0, 0.0, 0.0, 0.0])
    WRITERS["text"](tmp_path / "model", {3: camera, 7: camera}, images)
    assert read_model(tmp_path / "model")[0].lens is None
    strong = ("OPENCV", 48, 48, [50.0, 51.0, 24.0, 25.0, 2e3, 0.0, 0.0, 0.0])
    WRITERS["text"](tmp_path / "strong", {3: strong, 7: strong}, images)
    with pytest.raises(InputError, match="k1 = 2000"):
        read_model(tmp_path / "strong")
    assert len(COLMAP_MODELS) == 11
