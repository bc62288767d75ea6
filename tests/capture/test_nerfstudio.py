# SPDX-License-Identifier: MIT
import json
import math

import numpy as np
import pytest
import torch
from PIL import Image

from pinwm_drake.capture.check import check_capture
from pinwm_drake.capture.importers.nerfstudio import import_nerfstudio
from pinwm_drake.capture.importers.similarity import Similarity, read_similarity, scaled_world
from pinwm_drake.capture.importers.target import Scenery
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.capture.static_views import read_views
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.rotations import quaternion_to_matrix
from tests.capture.cube import SIDE, read_static_views, write_mesh, write_views
from tests.capture.pushed_cube import X_WO


@pytest.fixture
def source(tmp_path):
    return write_views(tmp_path / "source", size=48, count=8)


@pytest.fixture
def scenery(tmp_path):
    return Scenery("cube", write_mesh(tmp_path / "cube.obj"), X_WO())


def change(source, edit):
    path = source / "transforms.json"
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document))


def same_views(one, other):
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        torch.testing.assert_close(a.camera.intrinsics, b.camera.intrinsics, rtol=0, atol=1e-9)
        torch.testing.assert_close(quaternion_to_matrix(a.X_CO.q), quaternion_to_matrix(b.X_CO.q), rtol=0, atol=1e-12)
        torch.testing.assert_close(a.X_CO.p, b.X_CO.p, rtol=0, atol=1e-12)
        assert torch.equal(a.image, b.image)
        assert torch.equal(a.mask, b.mask)


def test_a_scan_becomes_a_capture(source, scenery, tmp_path):
    out = tmp_path / "out"
    assert import_nerfstudio(source, out, scenery) == 8
    same_views(read_static_views(out), read_views(source, X_WO()))
    capture = load_capture(out)
    assert (capture.object.name, capture.episode_names, capture.pusher.shape) == ("cube", [], None)
    assert (out / "meshes/object.obj").read_bytes() == scenery.mesh.read_bytes()
    assert [str(problem.problem) for problem in check_capture(out).problems if problem.severity == "error"] == []
    assert not list(tmp_path.glob(".*"))


def test_masks_and_cameras_of_their_own_are_kept(source, scenery, tmp_path):
    (source / "masks").mkdir()
    for path in sorted((source / "images").glob("*.png")):
        Image.open(path).getchannel("A").point(lambda alpha: 255 * (alpha > 0)).save(source / "masks" / path.name)
    change(source, lambda d: d["frames"][2].update(fl_x=70.0, cx=20.0))
    import_nerfstudio(source / "transforms.json", tmp_path / "out", scenery)
    same_views(read_static_views(tmp_path / "out"), read_views(source, X_WO()))


def test_what_nerf_leaves_out_is_filled_in(source, scenery, tmp_path):
    whole = read_views(source, X_WO())

    def to_nerf(document):
        angle = 2 * math.atan(0.5 * document["w"] / document["fl_x"])
        frames = [{**frame, "file_path": "./" + frame["file_path"][:-4]} for frame in document["frames"]]
        document.clear()
        document.update(camera_angle_x=angle, frames=frames)

    change(source, to_nerf)
    import_nerfstudio(source, tmp_path / "out", scenery)
    same_views(read_static_views(tmp_path / "out"), whole)


def test_a_world_in_other_units_and_axes_is_changed(source, scenery, tmp_path):
    expected = read_views(source, X_WO())
    # The source's world: 0.25 m to the unit, turned about x and shifted.
    R_WS, p_WS, scale = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([0.3, -0.2, 0.1]), 0.25
    X_SW = np.linalg.inv(np.vstack([np.column_stack([scale * R_WS, p_WS]), [0, 0, 0, 1]]))

    def to_source(document):
        for frame in document["frames"]:
            matrix = np.array(frame["transform_matrix"])
            matrix[:3, 3] = (X_SW @ [*matrix[:3, 3], 1])[:3]
            matrix[:3, :3] = R_WS.T @ matrix[:3, :3]
            frame["transform_matrix"] = matrix.tolist()

    change(source, to_source)
    path = tmp_path / "world.yaml"
    path.write_text(f"matrix: {np.linalg.inv(X_SW).tolist()}")
    import_nerfstudio(source, tmp_path / "out", scenery, read_similarity(path))
    same_views(read_static_views(tmp_path / "out"), expected)
    # The scale may stand apart.
    path.write_text(str(np.vstack([np.column_stack([R_WS, p_WS]), [0, 0, 0, 1]]).tolist()))
    assert read_similarity(path, scale).scale == pytest.approx(scale)
    import_nerfstudio(source, tmp_path / "other", scenery, read_similarity(path, scale))
    same_views(read_static_views(tmp_path / "other"), expected)


def test_a_scale_alone(source, scenery, tmp_path):
    change(source, lambda d: [frame["transform_matrix"][k].__setitem__(3, 4 * frame["transform_matrix"][k][3])
                              for frame in d["frames"] for k in range(3)])  # fmt: skip
    with pytest.raises(AssertionError):
        same_views(read_views(source, X_WO()), read_views(write_views(source.with_name("again"), count=8), X_WO()))
    import_nerfstudio(source, tmp_path / "out", scenery, scaled_world(0.25))
    same_views(read_static_views(tmp_path / "out"), read_views(source.with_name("again"), X_WO()))


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[[1, 0, 0, 0]]", "4 x 4"),
        ("matrix: [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,2]]", "last row"),
        ("matrix: [[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]", "scale -1"),
        ("matrix: [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "off"),
        ("matrix: [[0,0,0,0],[0,0,0,0],[0,0,0,0],[0,0,0,1]]", "scale 0"),
        ("hello", "a mapping"),
    ],
)
def test_wrong_similarities_are_refused(tmp_path, text, part):
    path = tmp_path / "world.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=part):
        read_similarity(path)


def test_a_similarity_moves_points_and_turns_cameras():
    similarity = Similarity(2.0, np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 0, 0]))
    X_WC = similarity.pose(X_WO())
    np.testing.assert_allclose(X_WC.p, [1, 0, SIDE], atol=1e-15)
    np.testing.assert_allclose(quaternion_to_matrix(X_WC.q), similarity.R_WS, atol=1e-15)


@pytest.mark.parametrize(
    ("edit", "part"),
    [
        (lambda d: d.update(k1=0.1), "k1 = 0.1"),  # of a PINHOLE
        (lambda d: d.update(camera_model="OPENCV", k4=0.1), "k4 = 0.1"),
        (lambda d: d.update(camera_model="OPENCV", k6=0.1), "k6 = 0.1"),
        (lambda d: d.update(camera_model="OPENCV_FISHEYE", p1=0.1), "p1 = 0.1"),
        (lambda d: d.update(camera_model="OPENCV", distortion_params=[0.1, 0, 0, 0, 0, 0]), "distortion_params"),
        (lambda d: d.update(is_fisheye="yes"), "is_fisheye"),
        (lambda d: d.update(camera_model="EQUIRECTANGULAR"), "OPENCV_FISHEYE"),
        (lambda d: d["frames"][1].update(file_path="images/none"), "images/none"),
        (lambda d: d["frames"][1].update(w=50), "48 x 48 px"),
        (lambda d: [d.pop("fl_x"), d.pop("fl_y")], "no fl_x"),
        (lambda d: d.pop("frames"), "no frames"),
    ],
)
def test_wrong_scans_are_refused_and_leave_nothing(source, scenery, tmp_path, edit, part):
    change(source, edit)
    with pytest.raises(InputError) as caught:
        import_nerfstudio(source, tmp_path / "out", scenery)
    assert part in str(caught.value)
    assert not (tmp_path / "out").exists()
    assert not list(tmp_path.glob(".*"))


def test_nothing_is_written_over(source, scenery, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "precious").write_text("")
    with pytest.raises(InputError, match="a new or empty folder"):
        import_nerfstudio(source, out, scenery)
    (out / "precious").unlink()
    import_nerfstudio(source, out, scenery)
    assert load_capture(out).object.name == "cube"


def test_a_broken_mesh_is_refused(source, scenery, tmp_path):
    scenery.mesh.write_text("v 0 0 0")
    with pytest.raises(InputError, match=r"cube\.obj"):
        import_nerfstudio(source, tmp_path / "out", scenery)


def angles(document, of):
    """Angles in place of focal lengths, in the file or in each frame."""
    for entry in document["frames"] if of == "frames" else [document]:
        for focal, size, key in (("fl_x", "w", "camera_angle_x"), ("fl_y", "h", "camera_angle_y")):
            entry[key] = 2 * math.atan(0.5 * document[size] / document[focal])
    del document["fl_x"], document["fl_y"]


@pytest.mark.parametrize("of", ["file", "frames"])
def test_both_angles_are_obeyed(source, scenery, tmp_path, of):
    change(source, lambda d: d.update(fl_y=0.97 * d["fl_x"]))
    whole = read_views(source, X_WO())
    change(source, lambda d: angles(d, of))
    import_nerfstudio(source, tmp_path / "out", scenery)
    same_views(read_static_views(tmp_path / "out"), whole)


def test_an_angle_of_a_frame_comes_before_the_focal_length_of_the_file(source, scenery, tmp_path):
    change(source, lambda d: d["frames"][1].update(fl_x=d["fl_x"] * 1.02))
    whole = read_views(source, X_WO())
    change(source, lambda d: d["frames"][1].update(camera_angle_x=2 * math.atan(24 / d["frames"][1].pop("fl_x"))))
    import_nerfstudio(source, tmp_path / "out", scenery)
    same_views(read_static_views(tmp_path / "out"), whole)


@pytest.mark.parametrize(
    ("edit", "part"),
    [
        (lambda d: d.update(camera_angle_y=0.7), "camera_angle_y = 0.7"),
        (lambda d: d.update(is_fisheye=True), "is_fisheye"),
        (lambda d: d["frames"][3].update(k6=0.1), "frames[3].k6"),
        (lambda d: d["frames"][3].update(lens="wide"), "an unknown key 'lens' under frames[3]"),
        (lambda d: [d.pop("fl_x"), d.update(camera_angle_x=25.0)], "are these degrees? 0.4363 rad"),
        (lambda d: d["frames"][3].update(file_path="./images/002.png"), "frames[2] too"),
        (lambda d: d["frames"][3].update(file_path="images/002"), "frames[2] too"),
    ],
)
def test_what_is_not_obeyed_is_refused_by_name(source, scenery, tmp_path, edit, part):
    change(source, edit)
    with pytest.raises(InputError) as caught:
        import_nerfstudio(source, tmp_path / "out", scenery)
    assert part in str(caught.value)


def test_an_image_without_suffix_that_may_be_two_is_refused(source, scenery, tmp_path):
    Image.open(source / "images/002.png").convert("RGB").save(source / "images/002.jpg")
    change(source, lambda d: d["frames"][2].update(file_path="images/002"))
    with pytest.raises(InputError, match=r"one image: images/002\.png or images/002\.jpg"):
        import_nerfstudio(source, tmp_path / "out", scenery)


@pytest.mark.parametrize("millimetres", [1000.0, 5000.0])
def test_a_scan_in_another_unit_is_told_with_its_scale(source, scenery, tmp_path, millimetres):
    def scale(document):
        for frame in document["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] *= millimetres

    expected = read_views(source, X_WO())
    change(source, scale)
    if millimetres == 1000.0:
        with pytest.warns(UserWarning, match=r"millimetres\? divide by 1000 \(at import: --scale 0.001\)"):
            import_nerfstudio(source, tmp_path / "far", scenery)
    else:
        with pytest.raises(InputError, match="within 1000 m; see --scale"):
            import_nerfstudio(source, tmp_path / "far", scenery)
    import_nerfstudio(source, tmp_path / "out", scenery, scaled_world(1 / millimetres))
    same_views(read_static_views(tmp_path / "out"), expected)


def test_images_without_a_pose_are_told(source, scenery, tmp_path):
    change(source, lambda d: d["frames"].pop())
    with pytest.warns(UserWarning, match=r"images/007\.png without a pose"):
        assert import_nerfstudio(source, tmp_path / "out", scenery) == 7
