# SPDX-License-Identifier: MIT
import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pinwm_drake.capture.scene import load_unfinished
from pinwm_drake.masks.start_pose import Outlines, find_start_pose, resting_faces
from pinwm_drake.spatial.poses import pose_to_matrix
from tests.geometry.test_hull import shots
from tests.masks.scenes import block, cameras, pose, write_photos


def apart(X, Y):
    turn = Rotation.from_matrix(X[:3, :3].T @ Y[:3, :3]).magnitude()
    return 1e3 * np.linalg.norm(X[:3, 3] - Y[:3, 3]), np.degrees(turn)


@pytest.mark.parametrize("roll", [0.0, np.pi / 2])
def test_a_pose_is_found_on_any_face_without_a_guess(roll):
    mesh, X = block(), pose()
    X[:3, :3] = X[:3, :3] @ Rotation.from_rotvec([roll, 0, 0]).as_matrix()
    X[2, 3] -= (mesh.vertices @ X[2, :3]).min() + X[2, 3]
    views = shots()[:10]
    found = find_start_pose(Outlines.of(views, [shot.outline(mesh, X) for shot in views]), mesh, 0.0)
    place, turn = apart(found.X_WO, X)
    assert place < 1.0  # the bar of the issue
    assert turn < 1.0
    assert found.rivals == []
    assert found.place < 1e-3


def test_one_camera_gives_a_pose_with_a_larger_doubt():
    mesh, views = block(), shots()[:10]
    outlines = Outlines.of(views, [shot.outline(mesh, pose()) for shot in views])
    all_views = find_start_pose(outlines, mesh, 0.0)
    one = find_start_pose(outlines.some(1), mesh, 0.0)
    place, turn = apart(one.X_WO, pose())
    assert place < 3.0
    assert turn < 3.0
    assert one.place > all_views.place


def test_a_block_has_faces_to_rest_on():
    ups = resting_faces(block())
    assert len(ups) >= 4
    assert max(abs(up[2]) for up in ups) > 0.99


def test_the_command_writes_the_pose_and_takes_those_of_others(tmp_path, pinwm):
    labels = write_photos(tmp_path, mesh=block())
    (tmp_path / "static/masks").mkdir()
    for k, label in enumerate(labels):
        cv2.imwrite(str(tmp_path / f"static/masks/{k:03}.png"), 255 * label.astype(np.uint8))
    code, said, errors = pinwm("pose", str(tmp_path))
    assert code == 0, errors
    assert "wrote object.X_WO" in said
    written = pose_to_matrix(load_unfinished(tmp_path).X_WO).numpy()
    assert max(apart(written, pose())) < 1.5
    near = Rotation.from_matrix(pose()[:3, :3]).as_quat()[[3, 0, 1, 2]]
    rows = ["t,px,py,pz,qw,qx,qy,qz", "0,0.2,0.2,0.0225,1,0,0,0", f"1,0.014,-0.003,0.0225,{','.join(map(str, near))}"]
    (tmp_path / "poses.csv").write_text("\n".join(rows) + "\n")
    code, said, errors = pinwm("pose", str(tmp_path), "--from", str(tmp_path / "poses.csv"), "--view", "images/003.png")
    assert code == 0, errors
    assert "a single view" in said
    assert "in place of" in said


def test_the_command_makes_a_mesh_of_masks_and_says_what_it_is(tmp_path, pinwm):
    labels = write_photos(tmp_path, views=cameras())
    (tmp_path / "static/masks").mkdir()
    for k, label in enumerate(labels):
        cv2.imwrite(str(tmp_path / f"static/masks/{k:03}.png"), 255 * label.astype(np.uint8))
    code, said, errors = pinwm("mesh", str(tmp_path))
    assert code == 0, errors
    assert "the hull of the masks" in said
    assert "cups are filled" in said
    code, _, errors = pinwm("mesh", str(tmp_path))
    assert code == 1
    assert "--replace" in errors
    scan = block()
    scan.apply_scale(1000.0)
    scan.export(tmp_path / "scan.stl")
    code, said, errors = pinwm("mesh", str(tmp_path), "--from", str(tmp_path / "scan.stl"), "--replace")
    assert code == 0, errors
    assert "read in mm" in said
