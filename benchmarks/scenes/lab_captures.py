# SPDX-License-Identifier: MIT
"""Captures of rendered labs, without masks, and what is true of them beside each: labels, poses, depths."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
import trimesh
from pydrake.math import RigidTransform, RotationMatrix

from benchmarks.scenes.lab_scenes import TIP, Case, Lab, as_pose, disturbed, looking, photo, ring
from pinwm_drake.capture.episode_tables import ObjectPoses, PusherTrajectory
from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.capture.write import write_capture_yaml, write_episode_tables, write_posed_images
from pinwm_drake.rendering.camera import Camera

TRUTH = "truth"  # folder beside the capture's files
_RATE, _LOG_RATE = 15.0, 125.0  # Hz, of films and of the pusher's log
_GAP = 0.06  # m, between rod and object before a push
_SPEED, _TURN = 0.14, 4.0  # m/s of the rod; rad for each metre that the object moves


def lab_camera(width: int = 640) -> Camera:
    """Camera with the angle of view of a phone, 4 : 3."""
    focal, height = 0.953 * width, 0.75 * width
    return Camera(width, round(height), torch.tensor([focal, focal, width / 2, height / 2], dtype=torch.float64))


def write_photos(
    case: Case,
    out: Path,
    *,
    width: int = 640,
    above: int = 24,
    grazing: int = 0,
    depth: bool = False,
    moved: tuple[int, float] = (0, 0.0),
    others: Sequence[tuple[str, str, RigidTransform]] = (),
) -> Path:
    """Write a capture of photos, without masks.

    Args:
        case: What is in the lab.
        out: The capture; `TRUTH` in it holds labels and true poses.
        width: Width of the photos, px.
        above: Number of photos from 28 to 65 degrees.
        grazing: Number of photos from 8 to 18 degrees, after those.
        depth: Flag: depths are written too, in mm, with the noise of a depth camera.
        moved: The object stands so far [m] elsewhere in the last so many photos.
        others: Further objects; see `Lab`.

    Returns:
        The capture.
    """
    camera, rng = lab_camera(width), np.random.default_rng(100 + case.seed)
    lab = Lab(case, out / TRUTH / "scene", camera, others)
    place = [*rng.uniform(-0.03, 0.03, 2), -lab.mesh.bounds[0, 2]]
    X_WO = RigidTransform(RotationMatrix.MakeZRotation(rng.uniform(-3, 3)), place)
    poses = ring(above, 28, 65, rng) + (ring(grazing, 8, 18, rng) if grazing else [])
    frames, truth = [], {"X_WO": X_WO.GetAsMatrix4(), "X_WC": np.array([X.GetAsMatrix4() for X in poses])}
    for folder in ("images", *(["depth"] if depth else [])):
        (out / "static" / folder).mkdir(parents=True, exist_ok=True)
    for k, X_WC in enumerate(poses):
        away = moved[1] if k >= len(poses) - moved[0] else 0.0
        here = X_WO.translation() + np.array([away, 0, 0])
        colour, label, far = lab.take(RigidTransform(X_WO.rotation(), here), X_WC)
        name = f"{k:05}"
        _write_jpeg(out / f"static/images/{name}.jpg", photo(colour, rng))
        _write_label(out / TRUTH / f"static/{name}.png", label)
        if depth:
            cv2.imwrite(
                str(out / f"static/depth/{name}.png"), np.round(1e3 * _depth_camera(far, rng)).astype(np.uint16)
            )
        frames.append((f"images/{name}.jpg", camera, as_pose(disturbed(X_WC, rng))))
    write_posed_images(out / "static/transforms.json", frames)
    np.savez(out / TRUTH / "poses.npz", **truth)
    _write_scene(out, lab, case)
    return out


def write_film(case: Case, out: Path, *, frames: int = 24) -> Path:
    """Add the film of a push to the capture of `write_photos`; returns its folder.

    The object rests while the rod comes, then it moves ahead of the rod and turns.
    """
    truth = np.load(out / TRUTH / "poses.npz")["X_WO"]
    folder, camera = out / "episodes/0000", lab_camera()
    (folder / "rgb").mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(200 + case.seed)
    lab = Lab(case, out / TRUTH / "scene", camera)
    angle = rng.uniform(-0.6, 0.6)
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    turned = lab.mesh.vertices @ truth[:3, :3].T
    start = truth[:3, 3] * [1, 1, 0] + [0, 0, 0.025] - along * (max(np.abs(turned[:, :2]).max(), 0.05) + _GAP)
    points = trimesh.sample.sample_surface(lab.mesh, 20_000, seed=0)[0] @ truth[:3, :3].T
    beside = np.abs(points @ [-along[1], along[0], 0.0]) < TIP
    face = (points @ along)[beside].min() + truth[:3, 3] @ along
    X_WC = looking([0.12, -0.55, 0.5], [0, 0, 0.02])
    joints, poses, times = lab.reach(start, np.array([0, 0.6, 0, -1.3, 0, 1.2, 0])), [], np.arange(frames) / _RATE
    for k, time in enumerate(times):
        tip = start + along * _SPEED * time
        joints, pushed = lab.reach(tip, joints), max(tip @ along + TIP - face, 0.0)
        R_WO = RotationMatrix.MakeZRotation(_TURN * pushed) @ RotationMatrix(truth[:3, :3])
        X_WO = RigidTransform(R_WO, truth[:3, 3] + pushed * along)
        colour, label, _ = lab.take(X_WO, X_WC, joints)
        _write_jpeg(folder / f"rgb/{k:05}.jpg", photo(colour, rng, gain=0.006))
        _write_label(out / TRUTH / f"episodes/0000/{k:05}.png", label)
        poses.append(as_pose(X_WO))
    log = np.arange(-0.25, times[-1] + 0.25, 1 / _LOG_RATE)
    velocity = np.where(log[:, None] >= 0, _SPEED * along, 0.0)
    path = start + along * _SPEED * np.maximum(log, 0)[:, None] + rng.normal(0, 1e-4, (len(log), 3))
    upright = np.tile([1.0, 0, 0, 0], (len(log), 1))
    made = ObjectPoses(times, np.array([X.p.numpy() for X in poses]), np.array([X.q.numpy() for X in poses]))
    names = [f"rgb/{k:05}.jpg" for k in range(frames)]
    trajectory = PusherTrajectory(log, path, upright, velocity, None)
    write_episode_tables(folder, camera, as_pose(disturbed(X_WC, rng)), names, times, trajectory, made)
    return folder


def _write_scene(out: Path, lab: Lab, case: Case) -> None:
    """Write the mesh, and `capture.yaml` with a pose of which nobody knows anything."""
    (out / "meshes").mkdir(exist_ok=True)
    lab.mesh.export(out / "meshes/object.obj")
    write_capture_yaml(
        out,
        name=case.object,
        mesh="meshes/object.obj",
        mass=None,
        X_WO=as_pose(RigidTransform([0, 0, -lab.mesh.bounds[0, 2]])),
        pusher_mesh=None,
        pusher_shape=PusherShape("sphere", TIP),
        floor_height=0.0,
        gravity=9.81,
    )


def _depth_camera(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Depths [m] as a stereo camera gives them: smeared and empty at edges, with noise in patches and a bias."""
    seen = cv2.medianBlur(np.where(np.isfinite(depth), depth, 0).astype(np.float32), 5)
    patches = cv2.GaussianBlur(rng.normal(size=seen.shape).astype(np.float32), (0, 0), 2)
    noisy = seen + patches / patches.std() * 0.0012 * (seen / 0.45) ** 2 + rng.normal(0, 0.001)
    edges = cv2.dilate(np.abs(cv2.Laplacian(seen, cv2.CV_32F)), np.ones((5, 5))) > 0.02
    return np.where(edges | (seen <= 0), 0, noisy)


def _write_jpeg(path: Path, picture: np.ndarray) -> None:
    cv2.imwrite(str(path), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])


def _write_label(path: Path, label: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), 255 * label.astype(np.uint8))
