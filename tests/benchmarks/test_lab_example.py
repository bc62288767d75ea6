# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from pydrake.math import RigidTransform

from benchmarks.lab_example.__main__ import Example
from benchmarks.lab_example.scene import COLUMNS, ExampleLab, LensCamera, Sizes
from benchmarks.next_push.engines.rollout import LOG_RATE, Rollout
from pinwm_drake.capture.importers.columns import make_trajectory, parse_columns
from pinwm_drake.capture.importers.recordings import read_film, read_log
from pinwm_drake.capture.lens import Lens
from pinwm_drake.guide.runs import push_files
from pinwm_drake.guide.stages import FILL_IN, LENS, PHOTOS, PRINT, PUSH, ROBOT, TABLE
from pinwm_drake.spatial.rigid import apply

_SMALL = Sizes(above=6, grazing=4, board=(5, 6, 3), phone=320, finer=1)


def still(lab: ExampleLab, push) -> Rollout:
    """A push of eleven times and two pictures in which nothing moves."""
    return Rollout(np.arange(11) / LOG_RATE, [RigidTransform(lab.X_TO)] * 11, np.tile(push.p_WP, (11, 1)))


@pytest.mark.nightly
def test_the_example_fills_a_lab_as_the_guide_asks_for_it(tmp_path, monkeypatch):
    monkeypatch.setattr(ExampleLab, "roll_out", still)
    example = Example(tmp_path, 0, cad=False, sizes=_SMALL)
    assert "pinwm lab runs what is ready" in example.run(run=False)  # it has all that the calibration needs
    assert example.acts == [PRINT, FILL_IN, LENS, ROBOT, TABLE]
    example.do(PHOTOS)
    monkeypatch.setattr(example, "proposed", lambda folder: example.truth.own_push())
    example.do(PUSH)
    assert len(example.lab.pictures("photos")) >= 8
    assert len(example.lab.pictures("photos/fixed")) == 1
    film, log, _ = push_files(example.lab.pushes[0])
    assert len(read_film(film).t) == 2
    trajectory, _ = make_trajectory(read_log(log), parse_columns(COLUMNS))
    p_BP = apply(example.truth.X_BT, example.truth.own_push().p_WP)
    np.testing.assert_allclose(np.median(trajectory.p_WP, axis=0), p_BP, atol=5e-5)  # m: 50 um of noise, of 395 rows
    assert Example(tmp_path, 0, cad=False, sizes=_SMALL).acts == example.acts


def test_a_lens_sees_a_point_where_it_projects_it():
    lens = Lens(320, 180, "opencv", np.array([230.0, 229.0, 163.0, 88.0]), np.array([0.12, -0.28, 6e-4, -9e-4, 0.11]))
    eye = LensCamera(lens)
    p_C = np.array([[-0.35, 0.2, 1.0]])
    fx, fy, cx, cy = eye.camera.intrinsics.tolist()
    x, y = np.meshgrid(np.arange(eye.camera.width) + 0.5, np.arange(eye.camera.height) + 0.5)
    away = (x - fx * p_C[0, 0] - cx) ** 2 + (y - fy * p_C[0, 1] - cy) ** 2
    spot = eye.seen(np.uint8(255 * np.exp(-away / 8.0))).astype(float)  # of 2 px
    rows, columns = np.mgrid[0 : lens.height, 0 : lens.width] + 0.5
    found = np.array([(spot * columns).sum(), (spot * rows).sum()]) / spot.sum()
    assert found == pytest.approx(lens.project(p_C)[0], abs=0.1)  # px: the spot is bent by the distortion
