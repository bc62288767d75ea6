# SPDX-License-Identifier: MIT
import cv2
import numpy as np
import pytest
import torch
import trimesh
import yaml

from pinwm_drake.capture.episode_tables import PusherTrajectory
from pinwm_drake.capture.static_views import read_views
from pinwm_drake.capture.write import write_episode_tables
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.masking import mask_capture
from pinwm_drake.masks.segmenter import OnnxSegmenter
from pinwm_drake.masks.shots import Shot
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.rigid import to_pose
from tests.masks.scenes import BLUE, FOCAL, SIZE, block, cameras, iou, photo, pose, write_photos


def masks_of(folder, number=10):
    return [cv2.imread(str(folder / f"static/masks/{k:03}.png"), 0) > 127 for k in range(number)]


# Photos of 320 px show the object at some 100 px: a rim of one pixel is 4 % of it.
def test_masks_without_a_mesh(tmp_path, pinwm):
    labels = write_photos(tmp_path)
    code, said, errors = pinwm("mask", str(tmp_path))
    assert code == 0, errors
    assert "wrote 10 masks" in said
    assert "doubtful" not in said
    overlaps = [iou(mask, label) for mask, label in zip(masks_of(tmp_path), labels, strict=True)]
    assert np.median(overlaps) > 0.93
    assert min(overlaps) > 0.88
    assert len(read_views(tmp_path / "static")) == 10  # a capture's reader takes them


def test_masks_and_pose_with_a_mesh(tmp_path):
    labels = write_photos(tmp_path, mesh=block())
    found = mask_capture(tmp_path)
    overlaps = [iou(mask, label) for mask, label in zip(masks_of(tmp_path), labels, strict=True)]
    assert np.median(overlaps) > 0.95
    assert np.linalg.norm(found.static.pose.X_WO[:3, 3] - pose()[:3, 3]) < 1e-3  # the bar of the issue
    turn = found.static.pose.X_WO[:3, :3].T @ pose()[:3, :3]
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 1.0


def test_a_hand_made_mask_stays_and_own_ones_are_made_anew(tmp_path):
    labels = write_photos(tmp_path, views=cameras(6))
    (tmp_path / "static/masks").mkdir()
    mine = labels[3].copy()
    mine[150:155] = True
    cv2.imwrite(str(tmp_path / "static/masks/003.png"), 255 * mine.astype(np.uint8))
    content = (tmp_path / "static/masks/003.png").read_bytes()
    assert mask_capture(tmp_path).kept == 1
    again = mask_capture(tmp_path)
    assert (again.written, again.kept) == (5, 1)
    assert (tmp_path / "static/masks/003.png").read_bytes() == content


def tower():
    """Block with a tower on one end, which is not its own mirror image."""
    top = trimesh.creation.box((0.03, 0.03, 0.06)).apply_translation([0.03, -0.015, 0.05])
    return trimesh.boolean.union([block(), top], engine="manifold")


def two_boxes(gap):
    """Boxes of 50 mm side by side along x."""
    box, places = trimesh.creation.box((0.05, 0.05, 0.045)), [np.eye(4), np.eye(4)]
    for X, side in zip(places, (-1, 1), strict=True):
        X[:3, 3] = side * 0.5 * (0.05 + gap), 0, 0.0225
    return [(box, places[0], BLUE), (box, places[1], np.array([60.0, 150, 70]))]


def test_the_painted_mask_of_one_photo_tells_two_things_apart(tmp_path):
    labels = write_photos(tmp_path, two_boxes(0.01))
    (tmp_path / "static/masks").mkdir()
    cv2.imwrite(str(tmp_path / "static/masks/002.png"), 255 * labels[2].astype(np.uint8))  # seen from the side
    assert not any("two things" in reason for _, reason in mask_capture(tmp_path).doubts)
    overlaps = [iou(mask, label) for mask, label in zip(masks_of(tmp_path), labels, strict=True)]
    assert np.median(overlaps) > 0.93


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("moved", "moved between photos"),
        ("cut off", "the edge of the photo cuts"),
        ("millimetres", "is it in millimetres"),
        pytest.param("another unit", "in another unit", marks=pytest.mark.nightly),
        pytest.param("swapped", "another object", marks=pytest.mark.nightly),
        ("mirrored", "the mirrored mesh fits"),
        ("two things", "masks hold two things, apart in images/00"),
        pytest.param("two things far apart", "a second thing stands at (5", marks=pytest.mark.nightly),
    ],
)
def test_what_is_wrong_is_named_in_a_line(tmp_path, case, words):
    views, mesh, things = cameras(7), None, [(block(), pose(), BLUE)]
    if case == "moved":
        things = [things if k < 5 else [(block(), pose(0.06, 0.05), BLUE)] for k in range(7)]
    if case.startswith("two things"):
        things = two_boxes(0.055 if "far" in case else 0.03)
    if case == "cut off":
        views[4][:3, 3] += 0.13 * views[4][:3, 0]
    if case == "mirrored":
        things, mesh = [(tower(), pose(), BLUE)], tower().apply_transform(np.diag([-1.0, 1, 1, 1]))
    if case in ("millimetres", "another unit", "swapped"):
        mesh = block()
        if case == "swapped":
            mesh.apply_transform(np.diag([0.7, 1.6, 1.2, 1]))
        else:
            mesh.apply_scale({"millimetres": 1000.0, "another unit": 10.0}[case])
    write_photos(tmp_path, things, views, mesh)
    if case == "millimetres":
        with pytest.raises(InputError, match=words):
            mask_capture(tmp_path)
        return
    doubts = [reason for _, reason in mask_capture(tmp_path).doubts]
    assert any(words in reason for reason in doubts), doubts


class _Blueness(torch.nn.Module):
    """Mask of what is as blue as the pixel at a point."""

    def forward(self, image, points):
        index = points[0, 0].to(torch.int64)
        there = image[0].index_select(1, index[1:]).index_select(2, index[:1])[:, 0, 0]
        return 0.25 - (image - there[None, :, None, None]).abs().sum(1, keepdim=True)


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    path = tmp_path_factory.mktemp("onnx") / "blueness.onnx"
    example = (torch.zeros(1, 3, 96, 96), torch.zeros(1, 1, 2))
    program = torch.onnx.export(
        _Blueness(), example, dynamo=True, input_names=["image", "points"], output_names=["mask"]
    )
    program.save(path)
    return path


def test_a_segmenter_as_an_onnx_file(tmp_path, network):
    X_WC = cameras()[1]
    image, label = photo(X_WC, [(block(), pose(), BLUE.copy())])  # plain
    K = np.array([[FOCAL, 0, SIZE / 2 - 0.5], [0, FOCAL, SIZE / 2 - 0.5], [0, 0, 1]])
    shot = Shot("photo", image, K, np.linalg.inv(X_WC))
    (top,), _ = shot.project(np.array([[0.01, -0.005, 0.03]]) + pose()[:3, :3] @ [-0.03, 0, 0])
    mask = OnnxSegmenter([network])(shot, top, (0, 0, SIZE, SIZE))
    assert mask[label == 1].mean() > 0.3  # the top is of one colour, the sides are darker
    assert mask[label == 0].mean() < 0.01


def test_a_file_that_is_no_segmenter_is_refused(tmp_path, network):
    (tmp_path / "a.onnx").write_bytes(b"nonsense")
    with pytest.raises(InputError, match=r"a\.onnx"):
        OnnxSegmenter([tmp_path / "a.onnx"])


def test_too_few_views_are_refused(tmp_path):
    write_photos(tmp_path, views=cameras(4))
    with pytest.raises(InputError, match="4 views"):
        mask_capture(tmp_path)


def write_push(folder, name, X_WO, images=True):
    """Episode of the block at a pose, which a pusher comes near; returns where it is in the images."""
    episode, X_WC = folder / "episodes" / name, cameras()[1]
    t = 0.1 * np.arange(3)
    p_WP = np.stack([0.2 - 0.01 * np.arange(3), np.zeros(3), np.full(3, 0.03)], -1)
    log = PusherTrajectory(t, p_WP, np.tile([1.0, 0, 0, 0], (3, 1)), np.zeros((3, 3)), None)
    labels, names = [], [f"rgb/{k}.png" for k in range(3)]
    (episode / "rgb").mkdir(parents=True)
    camera = Camera(SIZE, SIZE, torch.tensor([FOCAL, FOCAL, SIZE / 2, SIZE / 2], dtype=torch.float64))
    write_episode_tables(episode, camera, to_pose(X_WC), names, t, log, None)
    if not images:
        for one in ("camera.json", "frames.csv"):
            (episode / one).unlink()
    for k in range(3):
        image, label = photo(X_WC, [(block(), X_WO, BLUE)], seed=20 + k)
        cv2.imwrite(str(episode / names[k]), image[..., ::-1])
        labels.append(label == 1)
    return labels


@pytest.mark.parametrize("with_mesh", [True, pytest.param(False, marks=pytest.mark.nightly)])
def test_pushes_start_where_their_start_yaml_says_and_may_have_no_film(tmp_path, with_mesh):
    write_photos(tmp_path, views=cameras(7), mesh=block())
    X, start = pose(), pose(-0.05, 0.04, 0.1)
    scene = {"object": {"name": "block", "mesh": "meshes/object.obj", "X_WO": document(X)}, "schema_version": 1}
    scene["pusher"] = {"shape": {"kind": "sphere", "radius": 0.01}}
    (tmp_path / "capture.yaml").write_text(yaml.safe_dump(scene))
    labels = write_push(tmp_path, "0000", start)
    (tmp_path / "episodes/0000/start.yaml").write_text(yaml.safe_dump({"X_WO": document(start)}))
    write_push(tmp_path, "0001", X, images=False)
    found = mask_capture(tmp_path, use_mesh=with_mesh)
    assert ("episodes/0001", "no film, and so no masks") in found.doubts
    masks = [cv2.imread(str(tmp_path / f"episodes/0000/masks/{k}.png"), 0) > 127 for k in range(3)]
    assert min(iou(mask, label) for mask, label in zip(masks, labels, strict=True)) > (0.9 if with_mesh else 0.85)
    if not with_mesh:
        del scene["object"]["X_WO"]
        (tmp_path / "capture.yaml").write_text(yaml.safe_dump(scene))
        doubts = dict(mask_capture(tmp_path, use_mesh=False).doubts)
        assert "needs a mesh, or object.X_WO" in doubts["episodes/0000"]


def document(X):
    """Pose of a document from a matrix (4, 4)."""
    found = to_pose(X)
    return {"p": found.p.tolist(), "q": found.q.tolist()}


def test_a_size_is_obeyed_or_told(tmp_path, pinwm):
    write_photos(tmp_path, views=cameras(6), mesh=block())
    code, _, errors = pinwm("mask", str(tmp_path), "--size", "0.1")
    assert code == 1
    assert "--size: got 0.1 and a mesh" in errors
    found = mask_capture(tmp_path, use_mesh=False, size=0.1)
    assert not any("--size" in reason for _, reason in found.doubts)
    found = mask_capture(tmp_path, use_mesh=False, size=2.0)
    words = "--size is 2 m, and the cameras' distance of 0.40 m allows 0.040 to 0.124 m: 0.124 m was taken"
    assert ("static", words) in found.doubts
