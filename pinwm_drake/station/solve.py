# SPDX-License-Identifier: MIT
"""Calibration of a lab from its corners and the robot's poses: one adjustment of lens, camera, board and table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pinwm_drake.capture.lens import Lens
from pinwm_drake.errors import ParameterError
from pinwm_drake.spatial.rigid import inverse, rigid
from pinwm_drake.station.board import Board, Seen
from pinwm_drake.station.bundle import Block, Bundle, Link, Noise, Photo
from pinwm_drake.station.lab import LENS, ROBOT, TABLE, LabDocument, LabPhoto, Mount
from pinwm_drake.station.start import fit_lens, guess_camera, guess_lens, guess_noise, locate, require_turns

FEWEST_ROBOT = 6  # photos with the robot's poses
_FAR_CORNER, _FAR_POSE = 6.0, 5.0  # standard deviations on one axis, from which on one is left out
_ROUNDS, _STEADY = 8, 0.01  # rounds of the noises' estimate, and relative change that ends them
_FACE_DOWN = rigid(w=[np.pi, 0.0, 0.0])  # X_QM: a board lies on the table with its face up
_STEEPEST = np.radians(45.0)
_PLANE, _PLACE = (2, 3, 4), (0, 1, 5)  # motions of the table, and of a board on it
_FIRST_NOISE = 2e-4, 0.02  # m and rad: bounds of the first guess of the robot's noise


@dataclass(frozen=True, eq=False)
class Sighting:
    """Photo of a lab with the corners that were found in it."""

    photo: LabPhoto
    seen: Seen


@dataclass(frozen=True, eq=False)
class Solution:
    """Calibration of a lab.

    Attributes:
        bundle: The adjustment at its solution.
        camera: Pose of the camera: X_BC, or X_EC of one in the hand.
        board: Pose of the board on the gripper X_EM; without meaning for a camera in the hand.
        table: The table T in the robot's base, z up.
        covariance: (n, n) of the unknowns.
        left_out: What was left out as an outlier, in words.
        later: Pose of the camera from the photo `split` on; None without one.
        standing: Pose X_BM of the board that stands on the table before a camera in the hand; None for a fixed one.
    """

    bundle: Bundle
    mount: Mount
    camera: Block
    board: Block
    table: Block
    covariance: np.ndarray
    left_out: list[str]
    later: Block | None = None
    standing: np.ndarray | None = None

    @property
    def lens(self) -> Lens:
        """Lens at the solution."""
        return self.bundle.lens


def solve(
    sightings: Sequence[Sighting],
    board: Board,
    lens: Lens,
    about: LabDocument,
    split: int | None = None,
) -> Solution:
    """Solve for all unknowns at once, and leave outliers out.

    Args:
        sightings: Photos with their corners.
        board: The board as printed.
        lens: Lens by all photos, as `first_lens` gives it.
        about: What the lab says of its camera and board.
        split: Number, among the photos of the robot, of the one from which on the camera has another pose; None for
            none.

    Raises:
        ParameterError: There are too few photos, they leave something open, or robot and photos do not go together.
    """
    mount = about.mount
    robot = [(one, one.photo.X_BE) for one in sightings if one.photo.kind == ROBOT and one.photo.X_BE is not None]
    if len(robot) < FEWEST_ROBOT:
        found = f"the board in {len(robot)} photos with poses of the robot"
        raise ParameterError(f"robot/: got {found}; allowed: {FEWEST_ROBOT} or more, better 20")
    require_turns([X_BE for _, X_BE in robot], "robot.csv")
    corners = board.corners_M
    located = {one.photo.name: locate(lens, corners[one.seen.numbers], one.seen.pixels) for one in sightings}
    pairs = [(X_BE, X_CM) for one, X_BE in robot if (X_CM := located[one.photo.name]) is not None]
    X_camera, X_board = guess_camera([X for X, _ in pairs], [X for _, X in pairs], mount == "hand")
    if mount == "hand":
        lying = [X_board]
    else:
        seen = [located[one.photo.name] for one in sightings if one.photo.kind == TABLE]
        lying = [X_camera @ X for X in seen if X is not None]
    table, camera = _table(lying), Block(X_camera)
    later = None if split is None else Block(X_camera.copy())
    moved = {one.photo.name for one, _ in robot[split:]} if split is not None else set[str]()
    raised = rigid([0.0, 0.0, about.board.thickness]) @ _FACE_DOWN
    gripped = Block(X_board)
    standing = (Link(table), Link(_place(table, X_board, raised)), Link(None, raised))
    photos: list[Photo] = []
    for one in sightings:
        name, kind, X_CM, X_BE = one.photo.name, one.photo.kind, located[one.photo.name], one.photo.X_BE
        own = later if later is not None and (kind == TABLE or name in moved) else camera
        chain: tuple[Link, ...]
        if kind == ROBOT and mount == "fixed":
            assert X_BE is not None
            X_found = X_BE if X_CM is None else own.X @ X_CM @ inverse(X_board)
            chain = (Link(own, inverted=True), Link(Block(X_found, told=X_BE)), Link(gripped))
        elif kind == ROBOT:
            assert X_BE is not None
            chain = (Link(own, inverted=True), Link(Block(X_BE.copy(), told=X_BE), inverted=True), *standing)
        elif X_CM is None:
            continue
        elif kind == LENS:
            chain = (Link(Block(X_CM)),)
        elif mount == "fixed":
            place = _place(table, own.X @ X_CM, raised)
            chain = (Link(own, inverted=True), Link(table), Link(place), Link(None, raised))
        else:
            assert X_BE is not None
            place, gripper = (
                _place(table, X_BE @ own.X @ X_CM, raised),
                Link(Block(X_BE.copy(), told=X_BE), inverted=True),
            )
            chain = (Link(own, inverted=True), gripper, Link(table), Link(place), Link(None, raised))
        photos.append(Photo(name, corners[one.seen.numbers], one.seen.pixels, chain))
    bundle = Bundle(lens, photos, Noise(0.2), about.scale_noise)
    bundle.noise = _first_noise(bundle)
    left_out = _estimate(bundle)
    X_BM = standing[0].X @ standing[1].X @ raised if mount == "hand" else None
    return Solution(bundle, mount, camera, gripped, table, bundle.covariance(), left_out, later, X_BM)


def first_lens(sightings: Sequence[Sighting], board: Board, size: tuple[int, int], model: str) -> Lens:
    """Lens by the corners of all photos, wherever the boards are.

    Raises:
        ParameterError: A photo shows the board as no such lens can.
    """
    corners = board.corners_M
    pairs = [(corners[one.seen.numbers], one.seen.pixels) for one in sightings]
    guess = guess_lens(size, model, pairs)  # type: ignore[arg-type]
    names = [one.photo.name for one in sightings]
    lens, _, _ = fit_lens(guess, [(name, *pair) for name, pair in zip(names, pairs, strict=True)])
    return lens


def _table(boards: Sequence[np.ndarray]) -> Block:
    """First guess of the table X_BT from poses X_BM (4, 4) of boards on it.

    Raises:
        ParameterError: There is no board, or the table stands upright, so that something is wrong with the poses.
    """
    if not boards:
        raise ParameterError("table/: got no photo of a board on the table; allowed: 3 or more, at several places")
    up = -np.median([X[:3, 2] for X in boards], 0)
    up /= np.linalg.norm(up)
    if up[2] < np.cos(_STEEPEST):
        angle = np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0)))
        raise ParameterError(
            f"the table: got a tilt of {angle:.0f} degrees against the robot's base; allowed: 45; are the poses those "
            "of the gripper in the base, and does the board lie on the table with its face up?"
        )
    X = upright(up)
    X[:3, 3] = np.mean([X[:3, 3] for X in boards], 0)
    return Block(X, _PLANE)


def upright(up: np.ndarray) -> np.ndarray:
    """Transform (4, 4) of the smallest turn that takes z to a unit vector (3,) with z above 0."""
    axis = np.cross([0.0, 0.0, 1.0], up)
    sine = float(np.linalg.norm(axis))
    return rigid(w=axis / max(sine, 1e-12) * np.arctan2(sine, up[2]))


def _place(table: Block, X_BM: np.ndarray, raised: np.ndarray) -> Block:
    """First guess of a board's place on the table from its pose X_BM (4, 4)."""
    X_TQ = inverse(table.X) @ X_BM @ inverse(raised)
    return Block(rigid([*X_TQ[:2, 3], 0.0], [0.0, 0.0, np.arctan2(X_TQ[1, 0], X_TQ[0, 0])]), _PLACE)


def _first_noise(bundle: Bundle) -> Noise:
    """First guess of the noises, from where the boards are seen."""
    told = [(block.X, block.told) for block in bundle.told if block.told is not None]
    place, angle = guess_noise([X for X, _ in told], [X for _, X in told])
    return Noise(0.2, float(np.clip(place, *_FIRST_NOISE)), float(np.clip(angle, *_FIRST_NOISE)))


def _estimate(bundle: Bundle) -> list[str]:
    """Adjust, estimate the noises, and leave outliers out; returns these in words."""
    for _ in range(3):
        bundle.adjust(robust=True)
        _rough_noise(bundle)
    _leave_out(bundle)
    for _ in range(_ROUNDS):
        bundle.adjust()
        change = bundle.estimate_noise()
        # What looked far off at the noises of before may be near enough now.
        if not _leave_out(bundle) and change.max() < _STEADY:
            break
    bundle.adjust()
    return _words(bundle)


def _rough_noise(bundle: Bundle) -> None:
    """Set the noises by medians, which outliers hardly move."""
    pixels = np.concatenate([np.linalg.norm(bundle.pixel_errors(photo), axis=1) for photo in bundle.photos])
    errors = np.array([block.error() for block in bundle.told])
    # Medians of the lengths of 2 and 3 normal numbers: 1.177 and 1.538 standard deviations.
    place, angle = (np.median(np.linalg.norm(errors[:, part], axis=1)) / 1.538 for part in (slice(3), slice(3, 6)))
    bundle.noise = Noise(max(float(np.median(pixels)) / 1.177, 0.02), max(float(place), 5e-5), max(float(angle), 5e-5))


def _leave_out(bundle: Bundle) -> bool:
    """Leave out corners and told poses that are far off, and take the others in; returns whether any changed."""
    changed = False
    for photo in bundle.photos:
        near = np.linalg.norm(bundle.pixel_errors(photo), axis=1) <= _FAR_CORNER * photo.blur * bundle.noise.pixel
        changed |= bool((near != photo.kept).any())
        photo.kept = near
    for block in bundle.told:
        error = block.error()
        place, angle = np.linalg.norm(error[:3]) / bundle.noise.place, np.linalg.norm(error[3:]) / bundle.noise.angle
        trusted = bool(max(place, angle) <= _FAR_POSE)
        changed |= trusted != block.trusted
        block.trusted = trusted
    return changed


def _words(bundle: Bundle) -> list[str]:
    """Corners and poses that are left out, in words."""
    words: list[str] = []
    for photo in bundle.photos:
        if not photo.kept.all():
            worst = float(np.linalg.norm(bundle.pixel_errors(photo)[~photo.kept], axis=1).max())
            words.append(f"{photo.name}: {(~photo.kept).sum()} of {len(photo.kept)} corners, up to {worst:.1f} px off")
        for link in photo.chain:
            if link.block is not None and link.block.told is not None and not link.block.trusted:
                error = link.block.error()
                place, angle = 1e3 * np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))
                words.append(f"{photo.name}: the robot's pose, {place:.1f} mm and {angle:.2f} degrees off")
    return words
