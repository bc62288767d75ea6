# SPDX-License-Identifier: MIT
"""First guesses of an adjustment: the lens and the boards in its photos, then camera, gripper and table."""

from collections.abc import Sequence

import cv2
import numpy as np

from pinwm_drake.capture.lens import Lens, LensModel
from pinwm_drake.errors import ParameterError
from pinwm_drake.spatial.rigid import apart, apply, inverse, mean, rigid, turn
from pinwm_drake.station.bundle import Block, Bundle, Link, Noise, Photo

_FOCALS = np.geomspace(0.25, 4.0, 17)  # of the width
_PIXEL = 0.2  # px, first guess of the noise
_FEWEST_TURNS = np.radians(8.0)  # standard deviation of the robot's turns about the second of their axes


def guess_lens(size: tuple[int, int], model: LensModel, photos: Sequence[tuple[np.ndarray, np.ndarray]]) -> Lens:
    """Lens without distortion whose focal length fits photos best.

    Args:
        size: Width and height of the photos, px.
        model: Model of the lens.
        photos: Corners of each photo: p_M (n, 3) [m] and pixels (n, 2).
    """
    width, height = size
    best: tuple[float, Lens] | None = None
    for focal in _FOCALS * width:
        lens = Lens(width, height, model, np.array([focal, focal, 0.5 * width, 0.5 * height]), _zeros(model))
        # Photos that the lens cannot have taken count as wrong by the whole image.
        errors = [float(width)] * len(photos)
        for k, (p_M, pixels) in enumerate(photos):
            if (X_CM := locate(lens, p_M, pixels)) is not None:
                wrong = lens.project(apply(X_CM, p_M)) - pixels
                errors[k] = min(float(np.sqrt((wrong**2).sum(1).mean())), errors[k])
        error = float(np.median(errors))
        if best is None or error < best[0]:
            best = error, lens
    assert best is not None
    return best[1]


def _zeros(model: LensModel) -> np.ndarray:
    return np.zeros(5 if model == "opencv" else 4)


def locate(lens: Lens, p_M: np.ndarray, pixels: np.ndarray) -> np.ndarray | None:
    """Pose X_CM (4, 4) of a board from its corners p_M (n, 3) [m] and their pixels (n, 2); None where there is none."""
    rays = lens.rays(pixels)
    if not np.isfinite(rays).all():
        return None
    try:
        count, turns, places, _ = cv2.solvePnPGeneric(
            p_M[:, None], rays[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return None
    found: list[tuple[float, np.ndarray]] = []
    for w, v in zip(turns[:count], places[:count], strict=True):
        w, v = cv2.solvePnPRefineLM(p_M[:, None], rays[:, None], np.eye(3), None, w, v)
        X_CM = rigid(v.ravel(), w.ravel())
        p_C = apply(X_CM, p_M)
        if np.isfinite(p_C).all() and (p_C[:, 2] > 1e-6).all():
            found.append((float(((p_C[:, :2] / p_C[:, 2:] - rays) ** 2).sum()), X_CM))
    return min(found, key=lambda one: one[0])[1] if found else None


def fit_lens(lens: Lens, photos: Sequence[tuple[str, np.ndarray, np.ndarray]]) -> tuple[Lens, list[np.ndarray], float]:
    """Lens and poses of the board in photos that say nothing else, and the noise of corners.

    Args:
        lens: First guess.
        photos: Name, p_M (n, 3) [m] and pixels (n, 2) of each photo.

    Returns:
        The lens, X_CM (4, 4) of each photo, and the standard deviation on each axis [px].

    Raises:
        ParameterError: In no photo the lens can see the board.
    """
    made = []
    for name, p_M, pixels in photos:
        X_CM = locate(lens, p_M, pixels)
        if X_CM is None:
            raise ParameterError(f"{name}: no pose of the board fits; allowed: photos of the board by one lens")
        made.append(Photo(name, p_M, pixels, (Link(Block(X_CM)),)))
    bundle = Bundle(lens, made, Noise(5.0 * _PIXEL))
    for _ in range(3):
        bundle.adjust(robust=True)
        errors = np.concatenate([bundle.pixel_errors(photo) for photo in made])
        # Median of a length whose two parts are normal: 1.177 standard deviations.
        bundle.noise = Noise(max(float(np.median(np.linalg.norm(errors, axis=1))) / 1.1774, 0.01))
    return bundle.lens, [photo.X_CM for photo in made], bundle.noise.pixel


def guess_camera(
    X_BE: Sequence[np.ndarray], X_CM: Sequence[np.ndarray], in_hand: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Camera and board from poses of the gripper and of the board in the camera; some may be wrong.

    Args:
        X_BE: Poses (4, 4) of the gripper in the robot's base.
        X_CM: Poses (4, 4) of the board in the camera.
        in_hand: Flag: the camera is on the gripper and the board stands still; otherwise the other way round.

    Returns:
        X_BC and X_EM of a camera that stands still, or X_EC and X_BM of one in the hand.
    """
    moved, seen = np.array(list(X_BE) if in_hand else [inverse(X) for X in X_BE]), np.array(X_CM)
    kept = np.ones(len(moved), bool)
    for _ in range(3):
        chosen = np.flatnonzero(kept)
        R, t = cv2.calibrateHandEye(
            [X[:3, :3] for X in moved[chosen]],
            [X[:3, 3] for X in moved[chosen]],
            [X[:3, :3] for X in seen[chosen]],
            [X[:3, 3] for X in seen[chosen]],
            method=cv2.CALIB_HAND_EYE_PARK,
        )
        camera = np.eye(4)
        camera[:3, :3], camera[:3, 3] = R, t.ravel()
        boards = [X @ camera @ Y for X, Y in zip(moved, seen, strict=True)]
        board = mean([boards[int(k)] for k in chosen])
        off = np.array([apart(one, board) for one in boards])
        limit = 5.0 * np.median(off, 0) + [1e-4, 1e-4]
        kept = (off < limit).all(1)
    return camera, board


def guess_noise(X_BE: Sequence[np.ndarray], told: Sequence[np.ndarray]) -> tuple[float, float]:
    """Medians of the distances [m] and angles [rad] on one axis between poses and those that the robot told."""
    off = np.median([apart(one, other) for one, other in zip(X_BE, told, strict=True)], 0) / 1.5382
    return max(float(off[0]), 1e-4), max(float(off[1]), 1e-4)


def second_turn(X_BE: Sequence[np.ndarray]) -> float:
    """Spread [rad] of the turns between poses (4, 4) about the second of their main axes."""
    middle = mean(list(X_BE))
    turns = np.array([turn(middle[:3, :3].T @ X[:3, :3]) for X in X_BE])
    return float(np.linalg.svd(turns - turns.mean(0), compute_uv=False)[1] / np.sqrt(len(turns)))


def require_turns(X_BE: Sequence[np.ndarray], name: str) -> None:
    """Require poses that turn about two axes at least; raise ParameterError otherwise."""
    spread = second_turn(X_BE)
    if spread < _FEWEST_TURNS:
        raise ParameterError(
            f"{name}: got poses that turn about one axis only ({np.degrees(spread):.1f} degrees about the second); "
            f"allowed: turns of 20 degrees or more about two axes"
        )
