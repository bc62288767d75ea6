# SPDX-License-Identifier: MIT
import cv2
import numpy as np
import pytest
from PIL import Image

from benchmarks.calibration import MEDIAN, WORST
from benchmarks.scenes.rendered_lab import MIDDLE, WORKSPACE, RenderedLab, look_at
from pinwm_drake.capture.static_views import TRANSFORMS
from pinwm_drake.capture.transforms import read_transforms
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.rigid import apart, apply, from_pose, inverse, rigid
from pinwm_drake.station.accuracy import across
from pinwm_drake.station.board import Detector
from pinwm_drake.station.document import StationDocument, load_station, write_station
from pinwm_drake.station.lab import LabDocument
from pinwm_drake.station.photos import pose_photos, write_photos
from tests.station.stations import plain_station, pose

NUMBER = 10
LAB = LabDocument(schema_version=1, ruler=0.1, robot={"length": "m"}, workspace=WORKSPACE)


def silent(*_):
    """No progress."""


def ring(p_BT):
    """Cameras of a phone around a point, from two heights."""
    for k in range(NUMBER):
        angle, height = 2.0 * np.pi * k / NUMBER, 0.35 + 0.1 * (k % 2)
        yield look_at(p_BT + np.array([0.4 * np.cos(angle), 0.4 * np.sin(angle), height]), p_BT) @ rigid(
            w=[0, 0, 0.1 * k]
        )


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Photos around a board on the table, a station as it is in truth, true X_WC of the photos, and points W of them.

    The points are the corners of the board at its true X_WM, and those up to 0.1 m above them, where an object is.
    """
    folder, lab = tmp_path_factory.mktemp("lab"), RenderedLab(3)
    X_WB = inverse(rigid(w=[*lab.tilt, 0.0]))
    (fx, fy, cx, cy), size = lab.lens.intrinsics.tolist(), [lab.lens.width, lab.lens.height]
    document = plain_station()
    document["camera"] |= {
        "size": size,
        "K": [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]],
        "distortion": lab.lens.distortion.tolist(),
        "X_WC": pose(X_WB @ lab.X_BC),
    }
    document["world"]["X_BW"] = pose(inverse(X_WB))
    document["world"]["table"]["height"] = float((X_WB @ lab.X_BT)[2, 3])
    write_station(folder / "station.yaml", StationDocument.model_validate(document))
    X_BM = lab._on_table(MIDDLE[:2] + 0.02, 0.7)
    photos = folder / "photos"
    (photos / "fixed").mkdir(parents=True)
    cv2.imwrite(str(photos / "fixed/0.png"), lab.draw(inverse(lab.X_BC) @ X_BM, lab.X_BC))
    truth = []
    for k, X_BC in enumerate(ring((X_BM @ np.array([0.126, 0.084, 0.0, 1.0]))[:3])):
        cv2.imwrite(str(photos / f"{k}.png"), lab.draw(inverse(X_BC) @ X_BM, X_BC))
        truth.append(X_WB @ X_BC)
    corners = LAB.printed_board().corners_M
    p_M = np.concatenate([corners - np.array([0, 0, up]) for up in (0.0, 0.05, 0.1)])  # z of M is down
    return photos, load_station(folder / "station.yaml"), np.array(truth), apply(X_WB @ X_BM, p_M)


@pytest.fixture(scope="module")
def written(made, tmp_path_factory):
    """What was found of the photos, and the folder of the static views that were written."""
    (photos, station, *_), folder = made, tmp_path_factory.mktemp("written")
    found = pose_photos(photos, LAB, station, silent)
    write_photos(photos, found, folder)
    return found, folder


def test_photos_are_posed_in_the_world_of_the_station(made, written):
    (_, station, truth, p_W), (found, folder) = made, written
    assert (found.names, found.left_out) == ([f"{k}.png" for k in range(NUMBER)], [])
    errors = []
    for X, X_WC in zip(found.X_WC, truth, strict=True):
        # Distance and focal length go together: a pose is as good as the places at which it sees points.
        p_C = apply(inverse(X_WC), p_W)
        off = found.lens.project(apply(inverse(X), p_W)) - station.lens.project(p_C)  # the photos are by the same lens
        M = across(station.lens, inverse(X_WC), p_W)
        errors.append(1e3 * np.linalg.norm((M @ off[..., None])[..., 0], axis=1))
    assert np.median(errors) < MEDIAN
    assert np.max(errors) < WORST
    frames = read_transforms(folder / TRANSFORMS)
    assert apart(from_pose(frames[3].X_WC), found.X_WC[3])[0] < 1e-6


def test_a_pinhole_sees_the_board_where_its_pose_has_it(made, written):
    (_, station, *_), (_, folder) = made, written
    board = LAB.printed_board()
    p_W = []
    for frame in read_transforms(folder / TRANSFORMS)[:4]:
        seen = Detector(board).find(np.asarray(Image.open(frame.image_path).convert("L")))
        fx, fy, cx, cy = frame.camera.intrinsics.tolist()
        rays = np.column_stack([(seen.pixels - [cx, cy]) / [fx, fy], np.ones(len(seen.pixels))])
        X_WC = from_pose(frame.X_WC)
        rays, p = rays @ X_WC[:3, :3].T, X_WC[:3, 3]
        height = station.document.world.table.height
        on_table = np.full((len(board.corners_M), 3), np.nan)
        on_table[seen.numbers] = p + rays * ((height - p[2]) / rays[:, 2:])
        p_W.append(on_table)
    spread = np.nanmax(p_W, axis=0) - np.nanmin(p_W, axis=0)
    assert np.nanmax(spread) < 1e-3  # all photos see each corner at one place of the table


def test_what_does_not_show_the_board_is_named(made, tmp_path):
    photos, station, *_ = made
    with pytest.raises(InputError, match="fixed: no photo that shows the board"):
        pose_photos(tmp_path, LAB, station, silent)
    (tmp_path / "fixed").mkdir()
    (tmp_path / "fixed/0.png").write_bytes((photos / "fixed/0.png").read_bytes())
    for k in range(3):
        (tmp_path / f"{k}.png").write_bytes((photos / f"{k}.png").read_bytes())
    with pytest.raises(InputError, match="the board in 3 of 3 photos; allowed: 8 or more"):
        pose_photos(tmp_path, LAB, station, silent)
    cv2.imwrite(str(tmp_path / "fixed/0.png"), cv2.imread(str(photos / "0.png")))  # another place of the camera
    with pytest.raises(InputError, match="tilted by"):
        pose_photos(tmp_path, LAB, station, silent)
