# SPDX-License-Identifier: MIT
"""Small photos of a block on a table with grain, drawn without Drake, and captures of them."""

import json
from pathlib import Path

import cv2
import numpy as np
import trimesh
from PIL import Image

SIZE, FOCAL = 320, 400.0  # px
BLUE, TABLE = np.array([40.0, 80.0, 190.0]), np.array([178.0, 138.0, 96.0])
YELLOW, CELL = np.array([230.0, 210.0, 40.0]), 0.015  # of every second cell of blue things, m


def block() -> trimesh.Trimesh:
    """An L of two boxes, 90 x 60 x 45 mm, closed; the origin is the middle of its box."""
    long, short = trimesh.creation.box((0.09, 0.03, 0.045)), trimesh.creation.box((0.03, 0.06, 0.045))
    long.apply_translation([0, -0.015, 0])
    short.apply_translation([-0.03, 0.0, 0])
    return trimesh.boolean.union([long, short], engine="manifold")


def pose(x: float = 0.01, y: float = -0.005, yaw: float = 0.6) -> np.ndarray:
    """X_WO (4, 4) of the block on the table."""
    X = np.eye(4)
    X[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    X[:3, 3] = x, y, 0.0225
    return X


def cameras(number: int = 10, elevation: float = 32.0) -> list[np.ndarray]:
    """X_WC (4, 4), OpenCV axes, on a ring that looks at the table's middle."""
    found = []
    for k in range(number):
        angle, up = 2 * np.pi * k / number, np.radians(elevation + 24 * (k % 2))
        p = 0.4 * np.array([np.cos(up) * np.cos(angle), np.cos(up) * np.sin(angle), np.sin(up)])
        z = -p / np.linalg.norm(p)
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = np.stack([x, np.cross(z, x), z], 1), p
        found.append(X)
    return found


def photo(
    X_WC: np.ndarray, things: list[tuple[trimesh.Trimesh, np.ndarray, np.ndarray]], seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Photo (SIZE, SIZE, 3) uint8 with noise, and which thing each pixel shows, from 1; 0 for the table."""
    parts = [
        (mesh.triangles.tobytes(), X_WO.tobytes(), colour.tobytes(), colour is BLUE) for mesh, X_WO, colour in things
    ]
    key = X_WC.tobytes(), seed, *parts
    if key not in _DRAWN:
        _DRAWN[key] = _drawn(X_WC, things, seed)
    image, label = _DRAWN[key]
    return image.copy(), label.copy()


_DRAWN: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}  # photos of these tests, most of which many of them take


def _drawn(X_WC: np.ndarray, things: list, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.mgrid[0:SIZE, 0:SIZE]
    rays_C = np.stack([(columns + 0.5 - SIZE / 2) / FOCAL, (rows + 0.5 - SIZE / 2) / FOCAL, np.ones((SIZE, SIZE))], -1)
    rays = rays_C @ X_WC[:3, :3].T
    at = X_WC[:3, 3] - rays * (X_WC[2, 3] / rays[..., 2:])
    rng = np.random.default_rng(1)
    shade = np.zeros((SIZE, SIZE))
    for _ in range(8):
        wave = rng.normal(0, 150, 2)
        shade += 0.05 * np.sin(at[..., :2] @ wave + rng.uniform(0, 6))
    image, label = TABLE * (1 + shade[..., None]), np.zeros((SIZE, SIZE), int)
    depth = np.full((SIZE, SIZE), np.inf)
    for number, (mesh, X_WO, colour) in enumerate(things, start=1):
        p_C = (mesh.vertices @ X_WO[:3, :3].T + X_WO[:3, 3] - X_WC[:3, 3]) @ X_WC[:3, :3]
        for face, normal in zip(mesh.faces, mesh.face_normals @ X_WO[:3, :3].T, strict=True):
            c = p_C[face]
            n = np.cross(c[1] - c[0], c[2] - c[0])
            corners = np.round((c[:, :2] / c[:, 2:] * FOCAL + SIZE / 2 - 0.5) * 256).astype(np.int32)
            inside = np.zeros((SIZE, SIZE), np.uint8)
            cv2.fillConvexPoly(inside, corners, 1, cv2.LINE_8, 8)
            nearer = np.nonzero(inside)
            z = (n @ c[0]) / (rays_C[nearer] @ n)
            seen = (z > 0) & (z < depth[nearer])
            nearer, z = (nearer[0][seen], nearer[1][seen]), z[seen]
            light = 0.55 + 0.45 * max(float(normal @ [0.3, 0.2, 0.93]), 0.0)
            p_W = X_WC[:3, 3] + rays[nearer] * z[:, None]
            cells = np.floor((p_W - X_WO[:3, 3]) @ X_WO[:3, :3] / CELL + 0.25).astype(int).sum(axis=1) % 2 > 0
            shown = np.where((cells & (colour is BLUE))[:, None], YELLOW, colour)
            image[nearer], label[nearer], depth[nearer] = shown * light, number, z
    image = cv2.GaussianBlur(image, (0, 0), 0.5) + np.random.default_rng(seed).normal(0, 2.5, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8), label


def write_photos(folder: Path, things=None, views: list[np.ndarray] | None = None, mesh=None) -> list[np.ndarray]:
    """Write a capture without masks; returns where the first thing is in each photo, (SIZE, SIZE) bool.

    `things` are those of each view, or of all.
    """
    views = cameras() if views is None else views
    things = [(block(), pose(), BLUE)] if things is None else things
    (folder / "static/images").mkdir(parents=True)
    frames, labels = [], []
    for k, X_WC in enumerate(views):
        image, label = photo(X_WC, things[k] if isinstance(things[0], list) else things, seed=k)
        Image.fromarray(image).save(folder / f"static/images/{k:03}.png", compress_level=1)
        matrix = (X_WC @ np.diag([1.0, -1, -1, 1])).tolist()
        frames.append({"file_path": f"images/{k:03}.png", "transform_matrix": matrix})
        labels.append(label == 1)
    centre = SIZE / 2
    head = {"w": SIZE, "h": SIZE, "fl_x": FOCAL, "fl_y": FOCAL, "cx": centre, "cy": centre}
    (folder / "static/transforms.json").write_text(json.dumps({**head, "frames": frames}))
    if mesh is not None:
        (folder / "meshes").mkdir(exist_ok=True)
        mesh.export(folder / "meshes/object.obj")
        text = "schema_version: 1\nobject: {name: block, mesh: meshes/object.obj}\nfloor: {height: 0.0}\n"
        (folder / "capture.yaml").write_text(text)
    return labels


def iou(one: np.ndarray, other: np.ndarray) -> float:
    """Overlap of two masks."""
    return float((one & other).sum() / max((one | other).sum(), 1))
