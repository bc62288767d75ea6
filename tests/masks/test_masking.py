# SPDX-License-Identifier: MIT
import cv2
import numpy as np
import pytest
import torch

from pinwm_drake.capture.static_views import read_views
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.masking import mask_capture
from pinwm_drake.masks.segmenter import OnnxSegmenter
from pinwm_drake.masks.shots import Shot
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
    labels = write_photos(tmp_path)
    (tmp_path / "static/masks").mkdir()
    mine = labels[3].copy()
    mine[150:155] = True
    cv2.imwrite(str(tmp_path / "static/masks/003.png"), 255 * mine.astype(np.uint8))
    content = (tmp_path / "static/masks/003.png").read_bytes()
    assert mask_capture(tmp_path).kept == 1
    again = mask_capture(tmp_path)
    assert (again.written, again.kept) == (9, 1)
    assert (tmp_path / "static/masks/003.png").read_bytes() == content


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("moved", "moved between photos"),
        ("cut off", "the edge of the photo cuts"),
        ("millimetres", "is it in millimetres"),
        ("another unit", "in another unit"),
        ("swapped", "another object"),
    ],
)
def test_what_is_wrong_is_named_in_a_line(tmp_path, case, words):
    views, mesh, things = cameras(), None, [(block(), pose(), BLUE)]
    if case == "moved":
        things = [things if k < 7 else [(block(), pose(0.06, 0.05), BLUE)] for k in range(10)]
    if case == "cut off":
        views[4][:3, 3] += 0.13 * views[4][:3, 0]
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
        there = image[0, :, index[1]][:, index[0]]
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
    X_WC = cameras()[0]
    image, label = photo(X_WC, [(block(), pose(), BLUE)])
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
