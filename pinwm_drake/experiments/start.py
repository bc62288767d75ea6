# SPDX-License-Identifier: MIT
"""Pose of a capture's object at the start, from its masks or from another estimator."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh

from pinwm_drake.capture.episode_tables import read_pose_table
from pinwm_drake.capture.paths import is_file
from pinwm_drake.capture.scene import CAPTURE_FILE, load_unfinished
from pinwm_drake.documents import yaml_text
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.masking import read_shots, written_masks
from pinwm_drake.files import replacing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.masks.start_pose import Outlines, StartPose, find_start_pose, misfit, refine
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.reading.trees import parse_yaml
from pinwm_drake.spatial.poses import Pose, pose_to_matrix
from pinwm_drake.spatial.rotations import matrix_to_quaternion


@dataclass(frozen=True, eq=False)
class Start:
    """Pose of the object at the start.

    Attributes:
        pose: The pose, and how sure it is.
        views: Number of views that it is from.
        before: The pose that `capture.yaml` had; None for none.
    """

    pose: StartPose
    views: int
    before: Pose | None

    @property
    def X_WO(self) -> Pose:
        """Pose of the object in the world; q (4,), p (3,) [m]."""
        X = self.pose.X_WO
        return Pose(matrix_to_quaternion(torch.from_numpy(X[:3, :3].copy())), torch.from_numpy(X[:3, 3].copy()))


def start_pose(folder: Path, *, poses: Path | None = None, view: str | None = None) -> Start:
    """Find the pose of the object in the static views, without a guess.

    Args:
        folder: The capture, with mesh and masks.
        poses: Table of poses by another estimator; the one that fits the masks best is taken and refined. None to
            search resting faces and yaws.
        view: Name of the only view to use; None for all.

    Raises:
        InputError: There is no mesh, no mask, no such view, or the table is refused.
    """
    capture = load_unfinished(folder)
    if capture.mesh_path is None:
        raise InputError(folder / CAPTURE_FILE, value="no mesh", allowed="object.mesh; pinwm mesh makes one")
    mesh = load_mesh(capture.mesh_path)
    shots, known = read_shots(folder / "static")
    known = written_masks(folder / "static", shots) | known
    rows = [k for k in sorted(known) if view is None or shots[k].name == view]
    if view is not None and not rows:
        allowed = ", ".join(shots[k].name for k in sorted(known)[:3])
        raise InputError(folder / "static", value=f"no view {view} with a mask", allowed=f"{allowed} and others")
    outlines = Outlines.of([shots[k] for k in rows], [known[k] for k in rows])
    if not outlines.shots:
        raise InputError(folder / "static", value="no mask of the object", allowed="masks; pinwm mask makes them")
    if poses is None:
        guess = None if capture.X_WO is None else pose_to_matrix(capture.X_WO).numpy()
        found = find_start_pose(outlines, mesh, capture.floor_height, guess)
        assert found is not None
    else:
        found = _of_table(outlines, mesh, poses)
    return Start(found, len(outlines.shots), capture.X_WO)


def write_pose(folder: Path, X_WO: Pose) -> None:
    """Write the pose of the object to `capture.yaml`; its other keys stay, its comments do not.

    Raises:
        InputError: The file is missing or cannot be written.
    """
    path = folder / CAPTURE_FILE
    if not is_file(path):
        raise InputError(path, value="no such file", allowed=f"a {CAPTURE_FILE} to write the pose to; or --no-write")
    document = parse_yaml(read_bytes(path), path) or {}
    pose = {"p": [round(x, 6) for x in X_WO.p.tolist()], "q": [round(x, 9) for x in X_WO.q.tolist()]}
    document.setdefault("object", {})["X_WO"] = pose
    with replacing(path) as temporary:
        temporary.write_text(yaml_text(document), encoding="utf-8")


def _of_table(outlines: Outlines, mesh: trimesh.Trimesh, path: Path) -> StartPose:
    """Pose of a table that fits masks best, refined."""
    table = read_pose_table(path)
    candidates = [
        pose_to_matrix(Pose(torch.from_numpy(q), torch.from_numpy(p))).numpy()
        for p, q in zip(table.p_WO, table.q_WO, strict=True)
    ]
    best = min(candidates, key=lambda X: misfit(outlines, mesh, X))
    refined, covariance = refine(outlines, mesh, best, tilt=len(outlines.shots) > 1)
    if misfit(outlines, mesh, refined) > misfit(outlines, mesh, best):
        refined = best
    half = len(covariance) // 2 if len(covariance) == 6 else 2
    deviations = np.sqrt([np.linalg.eigvalsh(covariance[:half, :half]).max(), covariance[-1, -1]])
    return StartPose(refined, misfit(outlines, mesh, refined), float(deviations[0]), float(deviations[1]), [])
