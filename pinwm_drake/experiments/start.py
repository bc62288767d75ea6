# SPDX-License-Identifier: MIT
"""Pose of a capture's object at the start, from its masks or from another estimator."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh

from pinwm_drake.capture.amend import amend
from pinwm_drake.capture.episode_tables import read_pose_table
from pinwm_drake.capture.paths import is_file, require_file
from pinwm_drake.capture.scene import CAPTURE_FILE, load_unfinished
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.masking import read_shots
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.masks.start_pose import (
    Outlines,
    StartPose,
    deviations,
    find_start_pose,
    misfit,
    refine,
    seen_at,
    worst_view,
)
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rigid import from_pose, to_pose

POOR = 0.1  # share of differing pixels above which mesh and masks are doubtful
MISSES = 0.29  # above which a pose is refused: outlines of equal area overlap by an IoU of 0.75, as `align` asks for


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
        return to_pose(self.pose.X_WO)

    def words(self) -> list[str]:
        """How sure the pose is, one line each; doubts begin with "doubtful: "."""
        about = self.pose
        lines = [
            f"standard deviation {1e3 * about.place:.2f} mm and {math.degrees(about.turn):.2f}°; "
            f"outlines and masks differ by {100 * about.differing:.1f} % of the object"
        ]
        if self.views == 1:
            lines.append("doubtful: a single view: height and tilt are taken from the table")
        if about.differing > POOR:
            lines.append("doubtful: outlines and masks differ by much: look at the masks")
        if about.rivals:
            lines.append(f"doubtful: {len(about.rivals)} other poses fit nearly as well")
        return lines


def start_pose(folder: Path, *, poses: Path | None = None, view: str | None = None) -> Start:
    """Find the pose of the object in the static views, without a guess.

    Args:
        folder: The capture, with mesh and masks.
        poses: Table of poses by another estimator; the one that fits the masks best is taken and refined. None to
            search resting faces and yaws.
        view: Name of the only view to use; None for all.

    Raises:
        InputError: There is no mesh, no mask, no such view, the table is refused, or no pose fits the masks.
    """
    capture = load_unfinished(folder)
    if capture.mesh_path is None:
        raise InputError(folder / CAPTURE_FILE, value="no mesh", allowed="object.mesh; pinwm mesh makes one")
    mesh = load_mesh(require_file(capture.mesh_path, f"the mesh that {CAPTURE_FILE} names; pinwm mesh makes one"))
    shots, known, _ = read_shots(folder / "static")
    rows = [k for k in sorted(known) if view is None or shots[k].name == view]
    if view is not None and not rows:
        allowed = ", ".join(shots[k].name for k in sorted(known)[:3])
        raise InputError(folder / "static", value=f"no view {view} with a mask", allowed=f"{allowed} and others")
    outlines = Outlines.of([shots[k] for k in rows], [known[k] for k in rows])
    if not outlines.shots:
        raise InputError(folder / "static", value="no mask of the object", allowed="masks; pinwm mask makes them")
    height, row = capture.floor_height + 0.5 * float(mesh.extents.min()), None
    if poses is None:
        guess = None if capture.X_WO is None else from_pose(capture.X_WO)
        found = find_start_pose(outlines, mesh, capture.floor_height, guess)
        assert found is not None
    else:
        found, row = _of_table(outlines, mesh, poses, seen_at(outlines, height))
    if found.differing > MISSES:
        middle = _middle(mesh, found.X_WO)
        x, y, z = 1e3 * middle
        name, share = worst_view(outlines, mesh, found.X_WO)
        away = 1e3 * float(np.linalg.norm(middle - seen_at(outlines, height)))
        where = f"at ({x:.0f}, {y:.0f}, {z:.0f}) mm, {away:.0f} mm from the masks' place"
        differ = f"outlines differ by {found.differing:.0%} of the object, in {name} by {share:.0%}"
        allowed = f"{MISSES:.0%}; check unit, frame, mesh and masks"
        raise InputError(poses or capture.mesh_path, row=row, value=f"the best pose {where}: {differ}", allowed=allowed)
    return Start(found, len(outlines.shots), capture.X_WO)


def write_pose(folder: Path, X_WO: Pose) -> list[str]:
    """Write the pose of the object to `capture.yaml`, whose other keys stay.

    Returns:
        Lines of doubt, as `amend` has them.

    Raises:
        InputError: The file is missing, holds no mapping, or cannot be written.
    """
    path = folder / CAPTURE_FILE
    if not is_file(path):
        raise InputError(path, value="no such file", allowed=f"a {CAPTURE_FILE} to write the pose to; or --no-write")
    pose = {"p": [round(x, 6) for x in X_WO.p.tolist()], "q": [round(x, 9) for x in X_WO.q.tolist()]}
    return amend(path, {("object", "X_WO"): pose})


def _of_table(outlines: Outlines, mesh: trimesh.Trimesh, path: Path, place: np.ndarray) -> tuple[StartPose, int]:
    """Pose of a table that fits masks best, or else is nearest to a place (3,) [m], refined; its row, from 2."""
    table = read_pose_table(path)
    candidates = [
        from_pose(Pose(torch.from_numpy(q), torch.from_numpy(p))) for p, q in zip(table.p_WO, table.q_WO, strict=True)
    ]
    losses = [(misfit(outlines, mesh, X), float(np.linalg.norm(_middle(mesh, X) - place))) for X in candidates]
    k = losses.index(min(losses))
    best, before = candidates[k], losses[k][0]
    refined, covariance = refine(outlines, mesh, best, tilt=len(outlines.shots) > 1)
    after = misfit(outlines, mesh, refined)
    X_WO = best if after > before else refined
    return StartPose(X_WO, min(after, before), *deviations(covariance), []), k + 2


def _middle(mesh: trimesh.Trimesh, X_WO: np.ndarray) -> np.ndarray:
    """Middle (3,) [m, world] of a mesh at a pose (4, 4)."""
    return np.asarray(X_WO[:3, :3] @ mesh.bounds.mean(axis=0) + X_WO[:3, 3])
