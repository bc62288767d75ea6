# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import torch

from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import InputError
from pinwm_drake.geometry.meshes import half_diagonal, load_mesh
from pinwm_drake.paper.baselines.asid.cross_entropy import CrossEntropyBudget
from pinwm_drake.paper.reproduce import twins
from pinwm_drake.paper.reproduce.systems import task_scene
from pinwm_drake.paper.reproduce.twins import CaptureCell, NoisyCaptureCell, SurfelsCell, TrackedTwinCell, TwinCell
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import turn_between
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.twin.read import load_twin
from tests.capture.pushed_cube import write_pushed_cube
from tests.identification.samples import write_appearance, write_capture


def test_a_mesh_that_is_known_with_an_error_stays_a_solid_and_images_stay(tmp_path):
    capture = CaptureCell("push", 3)
    write_capture(tmp_path / capture.key)
    noisy = NoisyCaptureCell(capture, 0.02)
    before = load_mesh(load_capture(tmp_path / capture.key).object.mesh_path)
    for _ in range(2):  # over what a run left that was killed
        noisy.make(tmp_path, print)
    after = load_mesh(load_capture(tmp_path / noisy.key).object.mesh_path)
    assert after.is_watertight
    moved = after.vertices - before.vertices
    assert moved.std() == pytest.approx(0.02 * 2.0 * half_diagonal(before), rel=0.5)
    assert np.linalg.norm(moved, axis=1).min() > 0.0
    names = [
        sorted(path.relative_to(tmp_path / one.key) for path in (tmp_path / one.key).rglob("*.png"))
        for one in (capture, noisy)
    ]
    assert names[0] == names[1] != []


def test_a_mesh_that_is_fitted_to_masks_is_nearer_to_the_true_one_than_without(tmp_path):
    capture = CaptureCell("push", 3)
    write_pushed_cube(tmp_path / capture.key)
    cells = [NoisyCaptureCell(capture, 0.05), NoisyCaptureCell(capture, 0.05, refined=True)]
    told = [cell.make(tmp_path, print) for cell in cells]
    true, noisy, refined = (load_mesh(load_capture(tmp_path / one.key).object.mesh_path) for one in (capture, *cells))
    away = [np.linalg.norm(mesh.vertices - true.vertices, axis=1).mean() for mesh in (noisy, refined)]
    assert away[1] < 0.5 * away[0]
    assert told[1]["masks"]["after"] < 0.5 * told[1]["masks"]["before"]
    assert told[0] == {name: value for name, value in told[1].items() if name != "masks"}


def test_asid_writes_a_twin_that_scenes_take_with_the_poses_that_it_is_to_reproduce(tmp_path, monkeypatch):
    few = CrossEntropyBudget(samples=4, elites=2, rounds=2)
    monkeypatch.setattr(twins, "CrossEntropyBudget", lambda: few)
    cell = TrackedTwinCell(SurfelsCell(CaptureCell("push", 0, quick=True)), "asid")
    write_capture(tmp_path / cell.surfels.capture.key)
    write_appearance(tmp_path / cell.surfels.key)
    told = cell.make(tmp_path, print)
    twin = load_twin(tmp_path / cell.key)
    assert {name: one.value for name, one in twin.theta.items()} == told["theta"]
    assert {name: one["value"] for name, one in told["estimates"].items()} == told["theta"]
    assert twin.provenance["versions"]["pinwm_drake"]
    assert (tmp_path / cell.key / "episodes/0000.csv").is_file()
    assert sorted(path.name for path in (tmp_path / cell.surfels.key).iterdir()) == ["align.json", "surfels.ply"]
    assert load_setup(tmp_path / cell.key).twin.theta == twin.theta


def test_a_folder_without_surfels_is_refused(tmp_path):
    cell = TrackedTwinCell(SurfelsCell(CaptureCell("push", 0, quick=True)), "asid")
    write_capture(tmp_path / cell.surfels.capture.key)
    with pytest.raises(InputError, match=r"surfels\.ply"):
        cell.make(tmp_path, print)


def test_2d_physics_begins_where_the_static_views_have_the_object(tmp_path, monkeypatch):
    class Seen(Exception):
        pass

    def tracker(capture, *rest):
        raise Seen(capture.object.X_WO)

    turned, q = 0.07, torch.tensor([math.cos(0.035), 0.0, 0.0, math.sin(0.035)], dtype=torch.float64)
    X_OS = Pose(q, torch.tensor([0.007, 0.0, 0.0], dtype=torch.float64))
    for name, value in {"read_ply": None, "read_offset": (0.0, 0.0), "read_registration": X_OS}.items():
        monkeypatch.setattr(twins, name, lambda path, value=value: value)
    monkeypatch.setattr(twins, "PoseTracker", tracker)
    capture = CaptureCell("push", 3)
    write_pushed_cube(tmp_path / capture.key)
    written = load_capture(tmp_path / capture.key).object.X_WO
    with pytest.raises(Seen) as raised:
        TrackedTwinCell(SurfelsCell(capture), "2d-physics").make(tmp_path, print)
    (seen,) = raised.value.args
    assert float(turn_between(written.q, seen.q).norm()) == pytest.approx(turned)
    assert float((seen.p - written.p).norm()) == pytest.approx(0.007)


def test_cells_of_other_noise_unknowns_and_seeds_have_folders_of_their_own():
    capture = CaptureCell("push", 0)
    cells = [
        TwinCell(SurfelsCell(capture)),
        TwinCell(SurfelsCell(capture), only="mass"),
        TwinCell(SurfelsCell(NoisyCaptureCell(capture, 0.01))),
        TwinCell(SurfelsCell(NoisyCaptureCell(capture, 0.005))),
        TwinCell(SurfelsCell(CaptureCell("push", 1))),
        TwinCell(SurfelsCell(CaptureCell("flip", 0))),
        TwinCell(SurfelsCell(CaptureCell("push", 0, stand_in=True))),
    ]
    assert len({cell.key for cell in cells}) == len(cells)
    assert len({cell.surfels.key for cell in cells}) == len(cells) - 1


def test_the_true_theta_is_that_of_the_issue():
    assert task_scene("push").true_theta["friction_floor"] == 0.03
    assert task_scene("flip").true_theta["friction_floor"] == 0.2
    for task in ("push", "flip"):
        assert task_scene(task).true_theta["mass"] == 1.0
        assert task_scene(task).true_theta["restitution_floor"] == 0.0
        assert task_scene(task).capture(0, quick=True).friction == task_scene(task).true_theta["friction_floor"]
        assert task_scene(task).capture(0, quick=True).pusher_friction == task_scene(task).pusher_friction


def test_what_is_filmed_in_the_stand_in_is_one_episode_that_is_identified_from():
    captures = [CaptureCell("flip", 0, stand_in=flag) for flag in (False, True)]
    assert [one.episode for one in captures] == ["0001", "0000"]
    assert NoisyCaptureCell(captures[0], 0.01).episode == "0001"
