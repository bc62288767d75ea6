# SPDX-License-Identifier: MIT
"""Figures of the example: what the guide found beside the truth."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh

from benchmarks.lab_example.scene import WORKSPACE, ExampleLab
from benchmarks.masks import iou, overlap_summary, surface_distances
from benchmarks.results import markdown
from pinwm_drake.capture.clock import read_clock
from pinwm_drake.capture.images import read_mask
from pinwm_drake.capture.remap import Remap
from pinwm_drake.capture.scene import EPISODES, load_capture
from pinwm_drake.capture.static_views import find_mask
from pinwm_drake.capture.transforms import read_transforms
from pinwm_drake.experiments.prediction import predict
from pinwm_drake.experiments.progress import silent
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.guide.lab import LabFolder
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rigid import apply, from_pose, inverse, turn
from pinwm_drake.station.accuracy import across, within
from pinwm_drake.station.eye import pinhole_of
from pinwm_drake.station.lab import WorkspaceDocument
from pinwm_drake.station.photos import pose_photos
from pinwm_drake.twin.predict import TWO_SIDED
from pinwm_drake.twin.read import load_twin

PLACE, TURN = 5.0, 4.0  # bars: mm and degrees of the second push
_POINTS, _SURFACE = 6000, 30_000  # of the true mesh and of the one found


def figures(truth: ExampleLab, lab: LabFolder, first_twin: Path) -> dict[str, Any]:
    """Errors of the stages, ready for JSON: mm, degrees and ms."""
    X_TW = _world(truth, lab)
    mesh = load_mesh(lab.mesh)
    start = X_TW @ from_pose(load_capture(lab.capture).object.X_WO)
    X_MO, error = registered(mesh, truth.mesh, inverse(start) @ truth.X_TO.GetAsMatrix4())
    return {
        "calibration": calibration(truth, lab),
        "masks of photos": photo_masks(truth, lab),
        "mesh": error,
        "start pose": _apart(truth, start @ X_MO, truth.X_TO.GetAsMatrix4()),
        "pushes": {push.name: push_figures(truth, lab, push.name) for push in lab.pushes},
        "theta": theta(truth, first_twin),
        "predictions": {
            push.name: prediction(truth, lab, first_twin, push.name, X_TW, X_MO) for push in lab.pushes[1:]
        },
    }


def _world(truth: ExampleLab, lab: LabFolder) -> np.ndarray:
    """Pose X_TW (4, 4) of the calibrated world in the true table's frame."""
    station = lab.read_station()
    assert station is not None
    return inverse(truth.X_BT) @ from_pose(station.document.world.X_BW.pose())


def calibration(truth: ExampleLab, lab: LabFolder) -> dict[str, float]:
    """Distances within which points of the workspace are seen [mm], errors of the table [mm, degrees]."""
    station = lab.read_station()
    assert station is not None
    board = truth.board
    X_BW = from_pose(station.document.world.X_BW.pose())
    box = WorkspaceDocument.model_validate(WORKSPACE)
    p_B = apply(board.X_BT, box.points())
    p_C = apply(inverse(board.X_BC), p_B)
    shown = within(board.lens, p_C)
    p_W = apply(inverse(X_BW), p_B[shown])
    off = station.lens.project(apply(inverse(from_pose(station.X_WC)), p_W)) - board.lens.project(p_C[shown])
    M = across(board.lens, inverse(board.X_BC), p_B[shown])
    error = 1e3 * np.linalg.norm((M @ off[..., None])[..., 0], axis=1)
    X_TW = inverse(truth.X_BT) @ X_BW
    table = apply(X_TW, np.array([*apply(inverse(X_TW), np.zeros(3))[:2], station.document.world.table.height]))
    return {
        "points, median mm": _round(np.median(error)),
        "points, worst mm": _round(error.max()),
        "table, mm": _round(1e3 * table[2]),
        "tilt, deg": _round(np.degrees(np.arccos(min(X_TW[2, 2], 1.0)))),
    }


def photo_masks(truth: ExampleLab, lab: LabFolder) -> dict[str, float]:
    """Overlaps of the masks of the photos with the true ones, which are freed of distortion as the photos were."""
    station = lab.read_station()
    assert station is not None
    lens = pose_photos(lab.photos, lab.read_lab(), station, silent).lens
    frames, overlaps, remap = read_transforms(lab.transforms), [], Remap(lens, pinhole_of(lens))
    for frame in frames:
        path = find_mask(lab.static, frame.image_path)
        assert path is not None
        overlaps.append(iou(read_mask(path), _label(truth.truth / f"photos/{frame.image_path.stem}.png", remap)))
    return overlap_summary(overlaps)


def push_figures(truth: ExampleLab, lab: LabFolder, name: str) -> dict[str, Any]:
    """Error of a push's clock [ms], and overlaps of its masks with the true ones."""
    episode, known = lab.capture / EPISODES / name, np.load(truth.truth / f"push_{name}.npz")
    clock, station = read_clock(episode), lab.read_station()
    assert clock is not None
    assert station is not None
    remap = Remap(station.lens, pinhole_of(station.lens))
    paths = sorted((episode / "masks").glob("*.png"))
    labels = [_label(truth.truth / f"film_{name}/{path.stem}.png", remap) for path in paths]
    low, high = (1e3 * (end - clock.offset) for end in clock.interval)
    moved = known["X_TO"][-1] @ inverse(known["X_TO"][0])
    return {
        "images": len(paths),
        "clock, ms": _round(1e3 * (clock.offset - float(known["offset"]))),
        "clock interval, ms": [_round(low), _round(high)],
        "masks": overlap_summary([iou(read_mask(path), label) for path, label in zip(paths, labels, strict=True)]),
        "moves, mm": _round(1e3 * np.linalg.norm(known["X_TO"][-1][:3, 3] - known["X_TO"][0][:3, 3])),
        "turns, deg": _round(np.degrees(np.linalg.norm(turn(moved)))),
    }


def registered(mesh: trimesh.Trimesh, true: trimesh.Trimesh, guess: np.ndarray) -> tuple[np.ndarray, dict[str, float]]:
    """Pose X_MO (4, 4) of the true mesh in the frame of one that was found, by their surfaces, and how far they differ.

    Args:
        mesh: The mesh that was found, m, frame M.
        true: The true mesh, m, frame O.
        guess: (4, 4), X_MO about.
    """
    points = trimesh.sample.sample_surface(true, _POINTS, seed=0)[0]
    surface = trimesh.sample.sample_surface(mesh, _SURFACE, seed=1)[0]
    X_MO, _, _ = trimesh.registration.icp(
        points, surface, initial=guess, max_iterations=60, scale=False, reflection=False
    )
    moved = true.copy()
    moved.apply_transform(X_MO)
    (there, upright), (back, _) = surface_distances(moved, mesh), surface_distances(mesh, moved)
    return X_MO, {
        "chamfer, mm": _round(0.5 * (there.mean() + back.mean())),
        "sides, mm": _round(there[upright].mean()),
        "volume, %": _round(100 * (mesh.volume / true.volume - 1)),
        "triangles": len(mesh.faces),
    }


def theta(truth: ExampleLab, folder: Path) -> dict[str, Any]:
    """Parameters of a twin with their intervals, beside the truth where it has one."""
    true = truth.theta
    known = {"mass": true.mass, "friction_floor": true.friction_floor, "friction_pusher": true.friction_pusher}
    known["inertia_zz"] = float(true.inertia[2, 2])
    return {
        name: {
            "value": float(f"{one.value:.4g}"),
            "interval": None if one.interval is None else [float(f"{end:.4g}") for end in one.interval],
            "identifiable": one.identifiable,
            "truth": known.get(name),
        }
        for name, one in load_twin(folder).theta.items()
    }


def prediction(
    truth: ExampleLab, lab: LabFolder, folder: Path, name: str, X_TW: np.ndarray, X_MO: np.ndarray
) -> dict[str, Any]:
    """Error of the pose after a push as the twin in a folder predicts it from the log, and its 95 % interval."""
    found = predict(folder, lab.capture / EPISODES / name)
    known = np.load(truth.truth / f"push_{name}.npz")["X_TO"]
    last = Pose(*(_tensor(values[-1]) for values in (found.poses.q_WO, found.poses.p_WO)))
    error = _apart(truth, X_TW @ from_pose(last) @ X_MO, known[-1])
    spread, told = found.spread, None
    if spread is not None:
        x, y, yaw = (float(TWO_SIDED * values[-1]) for values in (spread.x, spread.y, spread.yaw))
        told = [_round(1e3 * x), _round(1e3 * y), _round(np.degrees(yaw))]
    return {**error, "interval, mm, mm, deg": told, "warnings": found.warnings}


def _tensor(values: np.ndarray) -> Any:
    import torch

    return torch.from_numpy(np.array(values))


def _apart(truth: ExampleLab, X: np.ndarray, Y: np.ndarray) -> dict[str, float]:
    """Distance of the middles of mass [mm] of two poses (4, 4) of the true object, and their turn [degrees]."""
    middle = truth.theta.p_com
    return {
        "place, mm": _round(1e3 * np.linalg.norm(apply(X, middle) - apply(Y, middle))),
        "turn, deg": _round(np.degrees(np.linalg.norm(turn(X[:3, :3].T @ Y[:3, :3])))),
    }


def _label(path: Path, remap: Remap) -> np.ndarray:
    """True mask (H, W) bool as a pinhole sees it."""
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    return remap(picture, outside=0) > 127


def _round(value: Any) -> float:
    return round(float(value), 3)


def table(runs: dict[str, dict[str, Any]]) -> str:
    """Table of the figures of runs by their names, with the bars, in Markdown."""
    columns = [_cells(found) for found in runs.values()]
    names = list(dict.fromkeys(name for cells in columns for name in cells))
    rows = [[name, *(cells.get(name, "") for cells in columns)] for name in names]
    return "\n".join(markdown(" | ".join(["what", *runs]), rows))


def _cells(found: dict[str, Any]) -> dict[str, str]:
    """Figures of a run in words, by what they are of."""
    calibrated, mesh, start = (found[key] for key in ("calibration", "mesh", "start pose"))
    points = calibrated["points, median mm"], calibrated["points, worst mm"]
    cells = {
        "acts of a person up to the second push; in all": f"{len(found['acts'])}; {found['acts in all']}",
        "calibration: points, median and worst": f"{points[0]:.2f} mm; {points[1]:.2f} mm",
        "table: height; tilt": f"{calibrated['table, mm']:+.2f} mm; {calibrated['tilt, deg']:.3f}°",
        "masks of the photos, IoU: median; worst": _overlap(found["masks of photos"]),
        "mesh: mean distance; that of sides; volume": (
            f"{mesh['chamfer, mm']:.2f} mm; {mesh['sides, mm']:.2f} mm; {mesh['volume, %']:+.1f} %"
        ),
        "pose at the start": _pose(start),
    }
    for name, push in found["pushes"].items():
        low, high = push["clock interval, ms"]
        cells |= {
            f"push {name} moves the object by": f"{push['moves, mm']:.0f} mm; {push['turns, deg']:.0f}°",
            f"push {name}: clock (95 % interval)": f"{push['clock, ms']:+.1f} ms ({low:+.1f} to {high:+.1f})",
            f"push {name}: masks, IoU: median; worst": _overlap(push["masks"]),
        }
    for name, one in found["theta"].items():
        if one["interval"] is not None and one["truth"] is not None:
            low, high = one["interval"]
            told = "" if one["identifiable"] else "; not identifiable"
            cells[f"{name} by the first push, in truth {one['truth']:.3g}"] = (
                f"{one['value']:.3g} ({low:.3g} to {high:.3g}{told})"
            )
    for name, of in (("0001", "proposed"), ("0002", "a person's")):
        ends = found["predictions"][name]
        met = ends["place, mm"] <= PLACE and ends["turn, deg"] <= TURN
        bar = f"bar {PLACE:g} mm, {TURN:g}°: {'met' if met else 'MISSED'}"
        cells[f"end of push {name} ({of}), predicted from the first"] = f"{_pose(ends)}; {bar}"
        cells[f"push {name}: 95 % of the twin's draws"] = _interval(ends["interval, mm, mm, deg"])
    cells["CPU time of the stages"] = f"{sum(found['cpu_seconds'].values()):.0f} s"
    if "policy" in found:
        policy = found["policy"]
        cells["policy in hydroelastic contact"] = f"{policy['success rate']:.0%}, {policy['minutes']:g} min of training"
    return cells


def _overlap(masks: dict[str, float]) -> str:
    return f"{masks['median']:.3f}; {masks['worst']:.3f}"


def _pose(error: dict[str, float]) -> str:
    return f"{error['place, mm']:.1f} mm; {error['turn, deg']:.1f}°"


def _interval(told: list[float] | None) -> str:
    return "none" if told is None else f"±{told[0]:.0f} mm in x, ±{told[1]:.0f} mm in y, ±{told[2]:.0f}°"
