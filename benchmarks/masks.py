# SPDX-License-Identifier: MIT
"""Masks, start poses and meshes of rendered labs, against the bars.

    python -m benchmarks.masks OUT [--sets 8] [--parts static,moving,pose,mesh] [--poses 25] [--write]

`--write` stores the figures in docs/results/masks.json. Captures in OUT are made once.
"""

import argparse
import json
import time
from pathlib import Path

import cv2
import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.results import machine
from benchmarks.scenes.lab_captures import TRUTH, write_film, write_photos
from benchmarks.scenes.lab_scenes import CASES, Case
from pinwm_drake.experiments.masking import mask_capture, read_shots
from pinwm_drake.experiments.meshing import read_depths
from pinwm_drake.geometry.hull.surface import hull_meshes
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.masks.start_pose import Outlines, find_start_pose
from pinwm_drake.masks.static import Found, find_masks
from pinwm_drake.provenance import timestamp, versions

RESULTS = Path(__file__).resolve().parent.parent / "docs/results/masks.json"
ABOVE, GRAZING = 16, 8  # photos of a set
PARTS = ("static", "moving", "pose", "mesh")
_POSES, _VIEWS = 25, 12  # poses of each set, views of each


def main() -> None:
    """Measure, print, and store with `--write`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.masks", description=__doc__)
    parser.add_argument("out", type=Path, help="folder of the captures")
    parser.add_argument("--sets", type=int, default=len(CASES), help="number of sets")
    parser.add_argument("--parts", default=",".join(PARTS), help="parts with commas between them")
    parser.add_argument("--poses", type=int, default=_POSES, help="number of poses of each set")
    parser.add_argument("--write", action="store_true", help="store the figures")
    given = parser.parse_args()
    parts, cases = given.parts.split(","), CASES[: given.sets]
    begun, figures = time.process_time(), {}
    for case in cases:
        folder = given.out / case.name
        if not (folder / TRUTH / "poses.npz").is_file():
            write_photos(case, folder, above=ABOVE, grazing=GRAZING, depth=True)
        measured = {name: globals()[f"measure_{name}"] for name in PARTS if name in parts}
        figures[case.name] = {
            name: of(case, folder, given.poses) if name == "pose" else of(case, folder) for name, of in measured.items()
        }
        print(case.name, json.dumps(figures[case.name]), flush=True)
        options = f"--sets {given.sets} --parts {given.parts} --poses {given.poses}"
        record = {
            "command": f"python -m benchmarks.masks OUT {options}",
            "of": f"{len(figures)} of {len(CASES)} sets, {ABOVE} views from above and {GRAZING} grazing ones each",
            "machine": machine(),
            "date": timestamp(),
            "versions": versions(("numpy", "opencv-python-headless", "manifold3d", "trimesh", "drake")),
            "cpu_seconds": round(time.process_time() - begun),
            "sets": figures,
        }
        if given.write:  # after each set: what is measured stays
            stored = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
            RESULTS.write_text(json.dumps(stored | {given.parts: record}, indent=1) + "\n")


def measure_static(case: Case, folder: Path) -> dict:
    """Overlap of masks without and with the mesh, from above and grazing; CPU time of a view."""
    shots, *_ = read_shots(folder / "static")
    labels = _labels(folder / TRUTH / "static", len(shots))
    found = {}
    for name, mesh in (("none", None), ("mesh", load_mesh(folder / "meshes/object.obj"))):
        begun = time.process_time()
        masks: Found = find_masks(shots, 0.0, mesh=mesh)
        seconds = (time.process_time() - begun) / len(shots)
        overlaps = [iou(mask, label) for mask, label in zip(masks.masks, labels, strict=True)]
        found[name] = {
            "above": overlap_summary(overlaps[:ABOVE]),
            "grazing": overlap_summary(overlaps[ABOVE:]),
            "seconds": round(seconds, 3),
            "doubts": [f"{view}: {reason}" for view, reason in masks.doubts],
        }
        if masks.pose is not None:
            truth = np.load(folder / TRUTH / "poses.npz")["X_WO"]
            found[name]["pose"] = _apart(mesh, masks.pose.X_WO, truth, case.object)
    return found


def measure_moving(case: Case, folder: Path) -> dict:
    """Overlap of the masks of a push."""
    episode = folder / "episodes/0000"
    if not (episode / "frames.csv").is_file():
        write_film(case, folder)
    begun = time.process_time()
    made = mask_capture(folder)
    labels = _labels(folder / TRUTH / "episodes/0000", len(list((episode / "rgb").glob("*.jpg"))))
    masks = _labels(episode / "masks", len(labels))
    doubts = [f"{name}: {reason}" for name, reason in made.doubts if name.startswith("episodes")]
    overlaps = [iou(mask, label) for mask, label in zip(masks, labels, strict=True)]
    return {"iou": overlap_summary(overlaps), "seconds": round(time.process_time() - begun, 1), "doubts": doubts}


def measure_pose(case: Case, folder: Path, number: int) -> dict:
    """Poses from 12 views with masks whose outlines waver, without a guess."""
    shots, *_ = read_shots(folder / "static")
    labels, mesh = _labels(folder / TRUTH / "static", len(shots)), load_mesh(folder / "meshes/object.obj")
    truth, errors, begun = np.load(folder / TRUTH / "poses.npz")["X_WO"], [], time.process_time()
    for seed in range(number):
        rng = np.random.default_rng([case.seed, seed])
        rows = np.sort(rng.choice(len(shots), _VIEWS, replace=False))
        masks = [wavering(labels[k], rng) for k in rows]
        found = find_start_pose(Outlines.of([shots[k] for k in rows], masks), mesh, 0.0)
        errors.append(_apart(mesh, found.X_WO, truth, case.object))
    good = sum(place <= 1.0 and turn <= 1.0 for place, turn in errors)
    seconds = (time.process_time() - begun) / number
    worst = np.max(errors, axis=0).round(2).tolist()
    return {"good": good, "of": number, "worst mm, deg": worst, "seconds": round(seconds, 2)}


def measure_mesh(case: Case, folder: Path) -> dict:
    """Meshes of the true masks that waver: from depths, and from masks alone; distances in mm."""
    shots, *_ = read_shots(folder / "static")
    rng = np.random.default_rng(case.seed)
    masks = [wavering(label, rng) for label in _labels(folder / TRUTH / "static", len(shots))]
    true = load_mesh(folder / "meshes/object.obj")
    true.apply_transform(np.load(folder / TRUTH / "poses.npz")["X_WO"])
    points = true.bounds
    found = {}
    for name, depths in (("hull", None), ("depth", read_depths(folder / "static", shots))):
        begun = time.process_time()
        mesh = hull_meshes(masks, [shot.P for shot in shots], points, 0.004, 0.0, depths)[0]
        there, sides = surface_distances(true, mesh)
        back, _ = surface_distances(mesh, true)
        found[name] = {
            "chamfer": round(float(there.mean() + back.mean()) / 2, 2),
            "sides": round(float(there[sides].mean()), 2),
            "volume": round(100 * (mesh.volume / true.volume - 1), 1),
            "triangles": len(mesh.faces),
            "seconds": round(time.process_time() - begun, 1),
        }
    return found


def iou(one: np.ndarray, other: np.ndarray) -> float:
    """Overlap of two masks."""
    return float((one & other).sum() / max((one | other).sum(), 1))


def wavering(mask: np.ndarray, rng: np.random.Generator, deviation: float = 1.0) -> np.ndarray:
    """Mask (H, W) bool whose outline is off by a deviation [px] in patches."""
    inside, outside = (cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 5) for part in (mask, ~mask))
    field = cv2.GaussianBlur(rng.normal(size=mask.shape).astype(np.float32), (0, 0), 5.0)
    return inside - outside + deviation * field / field.std() > 0


def _labels(folder: Path, number: int) -> list[np.ndarray]:
    return [cv2.imread(str(folder / f"{k:05}.png"), 0) > 127 for k in range(number)]


def overlap_summary(overlaps: list[float]) -> dict[str, float]:
    """Median and worst of overlaps."""
    return {"median": round(float(np.median(overlaps)), 3), "worst": round(min(overlaps), 3)}


def _apart(mesh: trimesh.Trimesh, X: np.ndarray, Y: np.ndarray, name: str) -> list[float]:
    """Distance of middles [mm] and turn [deg] of two poses, but for turns after which the object looks the same."""
    middle = mesh.bounds.mean(axis=0)
    place = 1e3 * float(np.linalg.norm((X[:3, :3] - Y[:3, :3]) @ middle + X[:3, 3] - Y[:3, 3]))
    turn = Rotation.from_matrix(X[:3, :3].T @ Y[:3, :3])
    if name == "mug":  # any turn about its axis
        return [round(place, 3), round(float(np.degrees(np.arccos(min(float(X[:3, 2] @ Y[:3, 2]), 1.0)))), 3)]
    same = {"cube": Rotation.create_group("O"), "t_block": Rotation.from_rotvec([[0, 0, 0], [0, np.pi, 0]])}
    best = min((turn * R).magnitude() for R in same.get(name, Rotation.identity(1)))
    return [round(place, 3), round(float(np.degrees(best)), 3)]


def surface_distances(mesh: trimesh.Trimesh, other: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Distances (n,) [mm] of points of a mesh from another one, and whether each lies on an upright side."""
    points, faces = trimesh.sample.sample_surface(mesh, 6000, seed=0)
    away = cKDTree(trimesh.sample.sample_surface(other, 300_000, seed=1)[0]).query(points)[0]
    return 1e3 * away, np.abs(mesh.face_normals[faces][:, 2]) < 0.5


if __name__ == "__main__":
    main()
