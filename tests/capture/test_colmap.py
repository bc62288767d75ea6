# SPDX-License-Identifier: MIT
import json
import struct

import numpy as np
import pytest
from PIL import Image

from pinwm_drake.capture.importers.colmap import import_colmap, read_model
from pinwm_drake.capture.importers.similarity import Similarity, scaled_world
from pinwm_drake.capture.importers.target import Scenery
from pinwm_drake.capture.static_views import read_views
from pinwm_drake.capture.transforms import read_transforms
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.poses import inverse
from tests.capture.cube import read_static_views, write_mesh, write_views
from tests.capture.pushed_cube import X_WO
from tests.capture.test_nerfstudio import same_views

IDENTITY = scaled_world()
# Of camera models in COLMAP's src/colmap/sensor/models.h.
NUMBERS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4, "OPENCV_FISHEYE": 5}
NUMBERS |= {"FULL_OPENCV": 6, "FOV": 7, "SIMPLE_RADIAL_FISHEYE": 8, "RADIAL_FISHEYE": 9, "THIN_PRISM_FISHEYE": 10}


def model_of(views):
    """COLMAP's records of nerfstudio views: cameras and images, by number."""
    frames = read_transforms(views / "transforms.json")
    focal, _, cx, cy = frames[0].camera.intrinsics.tolist()
    width, height = frames[0].camera.width, frames[0].camera.height
    cameras = {3: ("SIMPLE_PINHOLE", width, height, [focal, cx, cy])}
    cameras[7] = ("PINHOLE", width, height, [focal, focal, cx, cy])
    images = []
    for k, frame in enumerate(frames):
        X_CW = inverse(frame.X_WC)
        name = frame.file_path.removeprefix("images/")
        images.append((10 + k, [*X_CW.q.tolist(), *X_CW.p.tolist()], 3 if k % 2 else 7, name))
    return cameras, images


def write_text(folder, cameras, images):
    folder.mkdir(parents=True)
    lines = ["# Camera list with one line of data per camera:"]
    for number, (model, width, height, values) in cameras.items():
        lines.append(f"{number} {model} {width} {height} {' '.join(map(repr, values))}")
    (folder / "cameras.txt").write_text("\n".join(lines))
    lines = ["# Image list with two lines of data per image:"]
    for k, (number, pose, camera, name) in enumerate(images):
        lines.append(f"{number} {' '.join(map(repr, pose))} {camera} {name}")
        lines.append("" if k % 2 else "1.5 2.5 -1 3.0 4.0 17")  # an image may have no points
    (folder / "images.txt").write_text("\n".join(lines) + "\n")


def write_binary(folder, cameras, images):
    folder.mkdir(parents=True)
    data = struct.pack("<Q", len(cameras))
    for number, (model, width, height, values) in cameras.items():
        data += struct.pack(f"<iiQQ{len(values)}d", number, NUMBERS[model], width, height, *values)
    (folder / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(images))
    for k, (number, pose, camera, name) in enumerate(images):
        data += struct.pack("<i7di", number, *pose, camera) + name.encode() + b"\0"
        data += struct.pack("<Q", k) + struct.pack("<ddq", 1.5, 2.5, -1) * k
    (folder / "images.bin").write_bytes(data)


WRITERS = {"text": write_text, "binary": write_binary}


@pytest.fixture
def scan(tmp_path):
    """Nerfstudio views, whose images COLMAP's model is to have."""
    return write_views(tmp_path / "scan", size=48, count=8)


@pytest.fixture
def scenery(tmp_path):
    return Scenery("cube", write_mesh(tmp_path / "cube.obj"), X_WO())


@pytest.mark.parametrize("kind", WRITERS)
def test_a_model_becomes_a_capture(scan, scenery, tmp_path, kind):
    WRITERS[kind](scan / "sparse/0", *model_of(scan))
    assert import_colmap(scan, tmp_path / "out", scenery, IDENTITY) == 8
    same_views(read_static_views(tmp_path / "out"), read_views(scan, X_WO()))


def test_text_and_binary_are_equal(scan, tmp_path):
    cameras, images = model_of(scan)
    images[0], images[5] = images[5], images[0]
    write_text(tmp_path / "text", cameras, images)
    write_binary(tmp_path / "binary", cameras, images)
    for one, other in zip(read_model(tmp_path / "text"), read_model(tmp_path / "binary"), strict=True):
        assert one.path == other.path
        assert one.camera.intrinsics.tolist() == other.camera.intrinsics.tolist()
        assert [part.tolist() for part in one.X_SC] == [part.tolist() for part in other.X_SC]


def test_its_world_becomes_that_of_the_capture(scan, scenery, tmp_path):
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    similarity = Similarity(0.05, turn, np.array([0.1, 0.2, 0.3]))
    document = json.loads((scan / "transforms.json").read_text())
    expected = read_views(scan, X_WO())
    for frame in document["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, 3] = turn.T @ (matrix[:3, 3] - similarity.p_WS) / similarity.scale
        matrix[:3, :3] = turn.T @ matrix[:3, :3]
        frame["transform_matrix"] = matrix.tolist()
    (scan / "transforms.json").write_text(json.dumps(document))
    write_binary(scan / "sparse/0", *model_of(scan))
    import_colmap(scan / "sparse/0", tmp_path / "out", scenery, similarity)
    same_views(read_static_views(tmp_path / "out"), expected)


@pytest.mark.parametrize("name", ["{}.png.png", "{}.png"])
def test_masks_are_found_by_either_name(scan, scenery, tmp_path, name):
    write_text(scan / "model", *model_of(scan))
    (tmp_path / "masks").mkdir()
    for k in range(8):
        mask = np.zeros((48, 48), np.uint8)
        mask[15:35, 15:35] = 255
        Image.fromarray(mask).save(tmp_path / "masks" / name.format(f"{k:03}"))
    folders = {"images": scan / "images", "masks": tmp_path / "masks"}
    import_colmap(scan / "model", tmp_path / "out", scenery, IDENTITY, **folders)
    assert all(view.mask.sum() == 400 for view in read_static_views(tmp_path / "out"))
    (tmp_path / "masks" / name.format("004")).unlink()
    with pytest.raises(InputError, match="no mask 004"):
        import_colmap(scan / "model", tmp_path / "other", scenery, IDENTITY, **folders)


@pytest.mark.parametrize("kind", WRITERS)
def test_lenses_without_a_model_here_are_refused_with_a_hint(scan, tmp_path, kind):
    cameras, images = model_of(scan)
    cameras[3] = ("FOV", 48, 48, [50.0, 50.0, 24.0, 24.0, 0.1])
    WRITERS[kind](tmp_path / "model", cameras, images)
    with pytest.raises(InputError, match=r"camera model FOV; allowed: SIMPLE_PINHOLE.* undistort the images first"):
        read_model(tmp_path / "model")


@pytest.mark.parametrize(
    ("file", "old", "new", "row", "part"),
    [
        ("cameras.txt", "3 SIMPLE_PINHOLE 48", "3 SIMPLE_PINHOLE 0", 2, "width 0"),
        ("cameras.txt", "3 SIMPLE_PINHOLE 48", "3 SIMPLE_PINHOLE x", 2, "got x"),
        ("cameras.txt", "3 SIMPLE_PINHOLE 48", "3 SIMPLE_PINHOLE nan", 2, "got nan"),
        ("cameras.txt", "3 SIMPLE_PINHOLE", "3 PINHOLE", 2, "3 parameters"),
        ("cameras.txt", "3 SIMPLE_PINHOLE", "7 SIMPLE_PINHOLE", 3, "camera 7 again"),
        ("cameras.txt", "3 SIMPLE_PINHOLE 48 48", "3", 2, "got"),
        ("images.txt", " 7 000.png", " 8 000.png", 2, "camera 8"),
        ("images.txt", " 7 000.png", " 7", 2, "NAME"),
        ("images.txt", "10 ", "10 1", 2, "norm 1"),
        ("images.txt", "12 ", "12 1e400 ", 6, "got 1e400"),
        ("images.txt", " 7 000.png", " 7.5 000.png", 2, "7.5"),
        ("images.txt", "\n11 ", "\n10 ", 4, "image 10 again"),
        ("images.txt", "001.png", "000.png", 4, "image 000.png again"),
        ("images.txt", "1.5 2.5 -1 3.0 4.0 17", "1.5 2.5 -1 3.0 4.0", 3, "the points of 000.png"),
        ("images.txt", "1.5 2.5 -1 3.0 4.0 17", "1.5 2.5 -1 3.0 4.0 17.5", 3, "the points of 000.png"),
        ("images.txt", "1.5 2.5 -1 3.0 4.0 17\n", "", 3, "the points of 000.png"),
        ("images.txt", "001.png\n\n", "001.png\n", 5, "the points of 001.png"),
    ],
)
def test_wrong_texts_are_refused_with_their_line(scan, tmp_path, file, old, new, row, part):
    write_text(tmp_path / "model", *model_of(scan))
    path = tmp_path / "model" / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_model(tmp_path / "model")
    assert part in str(caught.value)
    assert (caught.value.path, caught.value.row) == (str(path), row)


def test_models_of_any_length_and_with_any_byte_changed_are_refused_or_read(scan, tmp_path):
    folder = tmp_path / "model"
    write_binary(folder, *model_of(scan))
    rng, refused = np.random.default_rng(0), 0
    for name in ("cameras.bin", "images.bin"):
        whole = (folder / name).read_bytes()
        pieces = [whole[:length] for length in range(0, len(whole), 7)]
        for _ in range(200):
            data = bytearray(whole)
            data[rng.integers(len(data))] = rng.integers(256)
            pieces.append(bytes(data))
        for data in pieces:
            (folder / name).write_bytes(data)
            try:
                read_model(folder)
            except InputError:
                refused += 1
        (folder / name).write_bytes(whole)
    assert refused > 150
    assert len(read_model(folder)) == 8


def test_models_and_images_have_to_be_there(scan, scenery, tmp_path):
    with pytest.raises(InputError, match=r"without images\.bin"):
        import_colmap(scan, tmp_path / "out", scenery, IDENTITY)
    with pytest.raises(InputError, match="no such folder"):
        import_colmap(scan / "nothing", tmp_path / "out", scenery, IDENTITY)
    write_text(scan / "sparse/0", *model_of(scan))
    (scan / "images/003.png").unlink()
    with pytest.raises(InputError, match=r"003\.png: no such file; allowed: the image that the model names"):
        import_colmap(scan, tmp_path / "out", scenery, IDENTITY)
    assert not (tmp_path / "out").exists()


def text_of(scan, change):
    """A text model whose lines of images are changed."""
    folder = scan / "sparse/0"
    write_text(folder, *model_of(scan))
    lines = (folder / "images.txt").read_text().splitlines()
    (folder / "images.txt").write_bytes(change(lines).encode())
    return folder


def test_empty_lines_comments_and_line_ends_lose_no_image(scan):
    def change(lines):
        head, *rest = lines
        pairs = [(rest[k], rest[k + 1]) for k in range(0, len(rest), 2)]
        text = [head, "", "# in the midst"]
        for k, (image, points) in enumerate(pairs):
            text += [image, *(["# a comment"] if k == 3 else []), points, *(["", "#", ""] if k % 3 == 0 else [])]
        return "\r\n".join(text).rstrip()  # without the last line, which is empty

    assert [image.path.name for image in read_model(text_of(scan, change))] == [f"{k:03}.png" for k in range(8)]


def test_one_line_an_image_is_refused_with_its_row(scan):
    folder = text_of(scan, lambda lines: "\n".join([lines[0], *lines[1::2]]))
    with pytest.raises(InputError, match=r"row 3.*the points of 000\.png"):
        read_model(folder)


def test_a_count_that_differs_is_told(scan):
    folder = text_of(
        scan, lambda lines: "\n".join([*lines[:1], "# Number of images: 9, mean observations: 2", *lines[1:]])
    )
    with pytest.warns(UserWarning, match="row 2: 9 images announced, 8 found"):
        assert len(read_model(folder)) == 8


@pytest.mark.parametrize("kind", WRITERS)
def test_names_with_spaces_and_folders_keep_their_masks(scan, scenery, tmp_path, kind):
    cameras, images = model_of(scan)
    names = [f"cam {k % 2}/a  {k // 2}.png" for k in range(8)]
    for k, name in enumerate(names):
        for folder in ("images", "masks"):
            (scan / folder / name).parent.mkdir(parents=True, exist_ok=True)
        (scan / "images" / images[k][3]).rename(scan / "images" / name)
        mask = np.zeros((48, 48), np.uint8)
        mask[15 : 20 + k, 15:35] = 255
        Image.fromarray(mask).save(scan / "masks" / f"{name}.png")
    WRITERS[kind](scan / "sparse/0", cameras, [(*image[:3], name) for image, name in zip(images, names, strict=True)])
    import_colmap(scan, tmp_path / "out", scenery, IDENTITY)
    order = sorted(range(8), key=lambda k: names[k])
    assert [int(view.mask.sum()) for view in read_static_views(tmp_path / "out")] == [20 * (5 + k) for k in order]


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin"])
@pytest.mark.parametrize(("more", "part"), [(-1, "more bytes after"), (1, "ends after")])
def test_binary_counts_have_to_match(scan, tmp_path, file, more, part):
    write_binary(tmp_path / "model", *model_of(scan))
    path = tmp_path / "model" / file
    data = path.read_bytes()
    path.write_bytes(struct.pack("<Q", struct.unpack_from("<Q", data)[0] + more) + data[8:])
    with pytest.raises(InputError, match=part):
        read_model(tmp_path / "model")


@pytest.mark.parametrize("which", ["camera", "number", "name"])
def test_binary_records_that_come_twice_are_refused(scan, tmp_path, which):
    cameras, images = model_of(scan)
    number, pose, camera, name = images[1]
    images[1] = (10 if which == "number" else number, pose, camera, "000.png" if which == "name" else name)
    write_binary(tmp_path / "model", cameras, images)
    if which == "camera":
        path = tmp_path / "model/cameras.bin"
        path.write_bytes(path.read_bytes().replace(struct.pack("<i", 7), struct.pack("<i", 3), 1))
    with pytest.raises(InputError, match=r"(camera 3|image 10|image 000\.png) again"):
        read_model(tmp_path / "model")


def test_images_and_models_that_are_left_out_are_told(scan, scenery, tmp_path):
    cameras, images = model_of(scan)
    write_binary(scan / "sparse/0", cameras, images[:6])
    write_binary(scan / "sparse/1", cameras, images[6:])
    with (
        pytest.warns(UserWarning, match=r"006\.png and 1 more without a pose"),
        pytest.warns(UserWarning, match="0 is imported, 1 left out"),
    ):
        import_colmap(scan, tmp_path / "out", scenery, IDENTITY)
