# SPDX-License-Identifier: MIT
"""Calibration of a lab's folder: from photos and the robot's poses to `station.yaml`."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.capture.lens import Lens
from pinwm_drake.capture.scene import PoseDocument
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import occupying
from pinwm_drake.provenance import timestamp, versions
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.spatial.rigid import apart, apply, inverse, to_pose
from pinwm_drake.station.accuracy import Accuracy, accuracy, scale_by_robot
from pinwm_drake.station.board import RULER, Board, Detector
from pinwm_drake.station.document import Station, StationDocument, write_station
from pinwm_drake.station.lab import (
    LAB_FILE,
    LENS,
    POSES_FILE,
    ROBOT,
    TABLE,
    Lab,
    LabDocument,
    LabPhoto,
    load_lab,
    read_grey,
)
from pinwm_drake.station.moved import Background, first_move, is_change, likely_change
from pinwm_drake.station.named import STATION_FILE
from pinwm_drake.station.pictures import write_pictures
from pinwm_drake.station.sharpen import Sharpener
from pinwm_drake.station.solve import Sighting, Solution, first_lens, solve, upright
from pinwm_drake.station.start import guess_camera, guess_noise, locate
from pinwm_drake.station.view import view_around

PICTURES = "residuals"
_MOST_NOISE = 5e-3, np.radians(1.5)  # of a robot, on one axis: m and rad
_SCALE_DOUBT, _SCALE_SPREADS = 0.01, 4.0  # of the ruler's reading, and in standard deviations
_PRINT_DOUBT = 0.002  # of the print's scale, from which on it is told
_TILT_DOUBT = np.radians(1.5)
_FEWEST_PHOTOS = 6
Progress = Callable[[str, float, str], None]


@dataclass(frozen=True, eq=False)
class Calibration:
    """Calibration of a lab.

    Attributes:
        lab: The folder as it was read.
        solution: Lens, camera, board and table.
        accuracy: Accuracy of the workspace and of the table.
        notes: Remarks, one line each: the print's scale, photos and corners that were left out, doubts.
        sightings: The photos that show the board.
    """

    lab: Lab
    solution: Solution
    accuracy: Accuracy
    notes: list[str]
    sightings: list[Sighting]


def _unheard(stage: str, done: float, figures: str) -> None:
    """Show progress to nobody."""


def calibrate(folder: Path, out: Path | None = None, progress: Progress = _unheard) -> tuple[Calibration, Station]:
    """Calibrate a lab, and write `station.yaml` and pictures of the residuals.

    Args:
        folder: The lab's folder; see docs/how-to/calibrate-a-station.md.
        out: Folder of the results; None for `station` in the lab's folder.
        progress: Called with a stage, the share of it that is done, and figures.

    Raises:
        InputError: A file is missing or wrong, or a photo is mirrored or of another size.
        ParameterError: The photos are too few, or camera, robot and board contradict each other.
    """
    lab = load_lab(folder)
    found = calibration_of(lab, progress)
    target = out or folder / "station"
    with occupying(target):
        write_pictures(target / PICTURES, found.solution.bundle, found.sightings)
        station = write_station(target / STATION_FILE, document_of(found))
    return found, station


def calibration_of(lab: Lab, progress: Progress = _unheard) -> Calibration:
    """Calibrate a lab without writing anything; arguments and errors as for `calibrate`."""
    board, about = lab.document.printed_board(), lab.document
    sightings, size, notes = _detect(lab, board, progress)
    scale = about.ruler / RULER
    if abs(scale - 1.0) > _PRINT_DOUBT:
        notes.insert(0, f"the board is printed at {100 * scale:.1f} %: its squares have {1e3 * board.square:.2f} mm")
    progress("solving", 0.0, "lens")
    lens = first_lens(sightings, board, size, about.lens)
    sightings = _sharpened(sightings, board, lens)
    progress("solving", 0.5, "camera, robot, board and table")
    solution = solve(sightings, board, lens, about)
    _require_scale(lab, solution)
    _require_still(sightings, board, lens, solution, about)
    _require_together(sightings, board, lens, solution)
    tilt = float(np.arccos(np.clip(solution.table.X[2, 2], -1.0, 1.0)))
    if tilt > _TILT_DOUBT:
        words = "is the base not level, or was the camera moved before the photos of table/?"
        notes.append(f"the table is tilted by {np.degrees(tilt):.1f} degrees against the robot's base: {words}")
    notes += [f"left out: {one}" for one in solution.left_out]
    progress("solving", 1.0, "done")
    X_BW = world_of(solution)
    box = about.workspace
    middle = np.mean([box.low, box.high], 0)
    reached = accuracy(solution, apply(X_BW, box.points()), apply(X_BW, middle))
    if not np.isfinite(reached.worst):
        raise InputError(lab.folder / LAB_FILE, value="a workspace out of sight", allowed="one that the camera sees")
    return Calibration(lab, solution, reached, notes, sightings)


def _detect(lab: Lab, board: Board, progress: Progress) -> tuple[list[Sighting], tuple[int, int], list[str]]:
    """Photos with their corners, the size of all photos, and what was left out, in words."""
    detector, sightings, notes = Detector(board), list[Sighting](), list[str]()
    size: tuple[int, int] | None = None
    mirrored: list[LabPhoto] = []
    background: Background | None = None
    moves: list[float | None] = []
    names: list[str] = []
    for k, photo in enumerate(lab.photos):
        progress("looking for the board", k / len(lab.photos), photo.name)
        grey = read_grey(photo.path)
        here = grey.shape[1], grey.shape[0]
        if size is not None and here != size:
            allowed = f"{size[0]} x {size[1]} px, as {lab.photos[0].name}"
            raise InputError(photo.path, value=f"{here[0]} x {here[1]} px", allowed=allowed)
        size = here
        seen = detector.find(grey)
        if seen is None:
            if detector.is_mirrored(grey):
                mirrored.append(photo)
            else:
                notes.append(f"left out: {photo.name}: no board in it, or fewer than 8 of its corners")
            continue
        sightings.append(Sighting(photo, seen))
        if lab.document.mount == "fixed" and photo.kind != LENS:
            background = background or Background(grey, seen)
            names.append(photo.name)
            moves.append(background.move(grey, seen))
    progress("looking for the board", 1.0, f"{len(sightings)} photos with it")
    if mirrored:
        more = f" and {len(mirrored) - 1} more photos" if len(mirrored) > 1 else ""
        found = f"a mirrored image{more}: the board is found when it is turned over"
        raise InputError(mirrored[0].path, value=found, allowed="photos as the camera takes them")
    if len(sightings) < _FEWEST_PHOTOS or size is None:
        found = f"the board in {len(sightings)} of {len(lab.photos)} photos"
        raise InputError(lab.folder, value=found, allowed=f"{_FEWEST_PHOTOS} or more; is it the board of lab.yaml?")
    if (move := first_move(names, moves)) is not None:
        before, after, pixels = move
        raise ParameterError(
            f"{lab.folder}: the camera was moved between {before} and {after}: what stands still moves by {pixels:.1f} "
            "px; allowed: photos of robot/ and table/ by a camera that stands still"
        )
    of_table = [move for name, move in zip(names, moves, strict=True) if name.startswith(f"{TABLE}/")]
    if of_table and set(of_table) == {None} and sum(move == 0.0 for move in moves) > len(moves) // 2:
        notes.append("what stands still in robot/ is not found again in table/: was the camera moved between them?")
    return sightings, size, notes


def _sharpened(sightings: Sequence[Sighting], board: Board, lens: Lens) -> list[Sighting]:
    """Photos with corners found again where a first lens should see them, and those that were missed before."""
    sharpener, found = Sharpener(board, lens), list[Sighting]()
    for one in sightings:
        seen = one.seen
        grey = read_grey(one.photo.path)
        for _ in range(2):  # the second time from a better pose
            X_CM = locate(lens, board.corners_M[seen.numbers], seen.pixels)
            better = None if X_CM is None else sharpener.find(grey, X_CM)
            if better is None or len(better.numbers) < 0.5 * len(seen.numbers):
                break
            seen = better
        found.append(Sighting(one.photo, seen))
    return found


def _require_scale(lab: Lab, solution: Solution) -> None:
    """Require the ruler's reading to go with the robot's motions; raise InputError otherwise."""
    reading = lab.document.scale_noise
    scale, spread = scale_by_robot(solution, reading)
    if abs(scale - 1.0) > max(_SCALE_DOUBT, _SCALE_SPREADS * np.hypot(spread, reading)):
        ruler = lab.document.ruler
        low, high = 1e3 * ruler * (scale - 2.0 * spread), 1e3 * ruler * (scale + 2.0 * spread)
        found = f"ruler = {1e3 * ruler:.1f} mm, and a board of another size"
        allowed = (
            f"{1e3 * ruler * scale:.1f} mm ({low:.1f} to {high:.1f}) by the robot's motions: the board is printed at "
            f"{100 * scale * ruler / RULER:.0f} %; measure the ruler again"
        )
        raise InputError(lab.folder / LAB_FILE, value=found, allowed=allowed)


def _require_still(
    sightings: Sequence[Sighting], board: Board, lens: Lens, solution: Solution, about: LabDocument
) -> None:
    """Require the robot's poses to show one pose of the camera; raise ParameterError otherwise."""
    robot = [one for one in sightings if one.photo.kind == ROBOT]
    poses = []
    shown = {photo.name: photo for photo in solution.bundle.photos}
    for one in robot:
        X_CM, X_BE = shown[one.photo.name].X_CM, one.photo.X_BE
        assert X_BE is not None
        if solution.mount == "fixed":
            poses.append(X_BE @ solution.board.X @ inverse(X_CM))
        else:
            assert solution.standing is not None
            poses.append(inverse(X_BE) @ solution.standing @ inverse(X_CM))
    split = likely_change(poses)
    if split is None:
        return
    other = solve(sightings, board, lens, about, split)
    if is_change(other):
        assert other.later is not None
        distance, angle = apart(other.camera.X, other.later.X)
        raise ParameterError(
            f"the camera was moved between {robot[split - 1].photo.name} and {robot[split].photo.name}: by "
            f"{1e3 * distance:.1f} mm and {np.degrees(angle):.2f} degrees; allowed: photos with the camera at one place"
        )


def _require_together(sightings: Sequence[Sighting], board: Board, lens: Lens, solution: Solution) -> None:
    """Require robot and photos to go together; raise ParameterError that names the cause, where one fits."""
    noise, trusted = solution.bundle.noise, [block.trusted for block in solution.bundle.told]
    if noise.place <= _MOST_NOISE[0] and noise.angle <= _MOST_NOISE[1] and np.mean(trusted) > 0.5:
        return
    robot = [one for one in sightings if one.photo.kind == ROBOT]
    corners, pairs = board.corners_M, list[tuple[np.ndarray, np.ndarray]]()
    for one in robot:
        X_CM = locate(lens, corners[one.seen.numbers], one.seen.pixels)
        if X_CM is not None and one.photo.X_BE is not None:
            pairs.append((one.photo.X_BE, X_CM))
    hand = solution.mount == "hand"
    causes = {
        "the poses are those of the base in the gripper: give those of the gripper in the base": (True, hand),
        f"the camera is {'fixed' if hand else 'in the hand'}: set mount": (False, not hand),
    }
    reason = "are photos and rows of robot.csv the same, in the stated units, and is the board fast?"
    for words, (turned_over, in_hand) in causes.items():
        told = [inverse(X) if turned_over else X for X, _ in pairs]
        X_camera, X_board = guess_camera(told, [X for _, X in pairs], in_hand)
        if in_hand:
            again = [X_board @ inverse(X_camera @ X) for _, X in pairs]
        else:
            again = [X_camera @ X @ inverse(X_board) for _, X in pairs]
        place, angle = guess_noise(again, told)
        if place < 0.3 * noise.place and angle < 0.3 * noise.angle:
            reason = words
            break
    found = f"{1e3 * noise.place:.0f} mm and {np.degrees(noise.angle):.1f} degrees apart on each axis"
    raise ParameterError(f"robot.csv and the photos do not go together: got poses {found}; {reason}")


def world_of(solution: Solution) -> np.ndarray:
    """World X_BW (4, 4): the robot's base, tilted so that z is the table's normal."""
    return upright(solution.table.X[:3, 2])


def document_of(found: Calibration) -> StationDocument:
    """Document of a calibrated station."""
    solution, about = found.solution, found.lab.document
    lens, table, bundle, reached = solution.lens, solution.table, solution.bundle, found.accuracy
    X_BW = world_of(solution)
    height = float(table.X[:3, 2] @ table.X[:3, 3])
    tilt = float(np.arccos(np.clip(table.X[2, 2], -1.0, 1.0)))
    fx, fy, cx, cy = map(float, lens.intrinsics)
    pose_key, X = "X_EC", solution.camera.X
    if solution.mount == "fixed":
        pose_key, X = "X_WC", inverse(X_BW) @ X
    columns = [*range(bundle.num_lens), *range(solution.camera.columns.start, solution.camera.columns.stop)]
    view = about.view
    if view is None and solution.mount == "fixed":
        box = about.workspace
        target = np.array([*np.mean([box.low, box.high], 0)[:2], height])
        view = view_around(X[:3, 3], box.points(2), target)
    camera: dict[str, Any] = {
        **about.camera.model_dump(),
        "mount": solution.mount,
        "size": (lens.width, lens.height),
        "model": lens.model,
        "K": ((fx, 0.0, cx), (0.0, fy, cy), (0.0, 0.0, 1.0)),
        "distortion": tuple(lens.distortion.tolist()),
        pose_key: _pose(X),
        "covariance": tuple(map(tuple, solution.covariance[np.ix_(columns, columns)].tolist())),
    }
    world = {
        "X_BW": _pose(X_BW),
        "table": {
            "height": height,
            "height_interval": (height - reached.height, height + reached.height),
            "tilt": tilt,
            "tilt_interval": (max(0.0, tilt - reached.tilt), tilt + reached.tilt),
        },
    }
    return StationDocument.model_validate(
        {
            "schema_version": 1,
            "name": about.name or found.lab.folder.resolve().name,
            "world": world,
            "camera": camera,
            "view": view,
            "latency": about.latency,
            "tool": about.tool,
            "workspace": about.workspace,
            "start": about.start,
            "accuracy": {"median": reached.median, "worst": reached.worst},
            "provenance": _provenance(found),
        }
    )


def _pose(X: np.ndarray) -> PoseDocument:
    pose = to_pose(X)
    return PoseDocument(p=tuple(pose.p.tolist()), q=tuple(pose.q.tolist()))


def _provenance(found: Calibration) -> dict[str, Any]:
    bundle, lab, solution = found.solution.bundle, found.lab, found.solution
    photos = {}
    for photo in bundle.photos:
        errors = bundle.pixel_errors(photo)[photo.kept]
        rms = float(np.sqrt((errors**2).mean())) if len(errors) else 0.0
        photos[photo.name] = {"corners": int(photo.kept.sum()), "rms_px": round(rms, 4)}
    digest = hashlib.sha256()
    for one in lab.photos:
        digest.update(f"{one.name}\n{hashlib.sha256(read_bytes(one.path)).hexdigest()}\n".encode())
    return {
        "made": timestamp(),
        "versions": versions(("numpy", "opencv-python-headless", "scipy")),
        "lab": str(lab.folder.resolve()),
        "sha256": {
            "lab.yaml": hashlib.sha256(read_bytes(lab.folder / LAB_FILE)).hexdigest(),
            "robot.csv": hashlib.sha256(read_bytes(lab.folder / POSES_FILE)).hexdigest(),
            "photos": digest.hexdigest(),
        },
        "ruler": lab.document.ruler,
        "board_scale": float(bundle.scale),
        "noise": {
            "pixel": float(bundle.noise.pixel),
            "robot_place": float(bundle.noise.place),
            "robot_angle": float(bundle.noise.angle),
        },
        "X_EM": None if solution.mount == "hand" else _pose(solution.board.X).model_dump(mode="json"),
        "notes": found.notes,
        "residuals": photos,
    }
