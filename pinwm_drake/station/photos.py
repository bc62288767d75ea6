# SPDX-License-Identifier: MIT
"""Poses of photos of an object on the table, by a board that lies beside it and that the station's camera sees too."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from pinwm_drake.capture.images import read_pixels
from pinwm_drake.capture.lens import Lens
from pinwm_drake.capture.remap import Remap
from pinwm_drake.capture.static_views import TRANSFORMS
from pinwm_drake.capture.write import write_posed_images
from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rigid import apply, from_pose, inverse, rigid, to_pose
from pinwm_drake.station.board import Board, Detector, Seen
from pinwm_drake.station.document import Station
from pinwm_drake.station.eye import pinhole_of
from pinwm_drake.station.lab import LabDocument, photos_in, read_grey
from pinwm_drake.station.start import fit_lens, guess_lens, locate

FIXED = "fixed"  # folder below the photos: what the station's camera saw meanwhile
FEWEST = 8  # photos
_STEEPEST = np.radians(5.0)  # of the board against the table
_STILL = 0.005  # m, between two sights of one board
Progress = Callable[[str, float, str], None]


@dataclass(frozen=True, eq=False)
class PosedPhotos:
    """Photos with poses.

    Attributes:
        names: Names of the photos.
        X_WC: (n, 4, 4), poses of their cameras in W, OpenCV axes.
        lens: Lens of the photos.
        noise: Standard deviation of corners on each axis, px.
        left_out: Names of photos that do not show the board.
    """

    names: list[str]
    X_WC: np.ndarray
    lens: Lens
    noise: float
    left_out: list[str]


def pose_photos(folder: Path, lab: LabDocument, station: Station, progress: Progress) -> PosedPhotos:
    """Find the poses of photos in the world of a station.

    Args:
        folder: Photos by one lens, zoom fixed, which show the board on the table; one or more by the station's camera
            are in `fixed`.
        lab: The lab, whose board it is.
        station: The station.
        progress: Called with a stage, the share of it that is done, and figures.

    Raises:
        InputError: Too few photos show the board, sizes differ, or the board was moved or does not lie on the table.
        ParameterError: No lens fits the photos.
    """
    board = lab.printed_board()
    X_WM = _board_on_table(folder / FIXED, board, lab.board.thickness, station)
    paths = photos_in(folder)
    sights, size = _sights(paths, board, progress)
    if len(sights) < FEWEST:
        found = f"the board in {len(sights)} of {len(paths)} photos"
        raise InputError(folder, value=found, allowed=f"{FEWEST} or more; the board lies beside the object")
    progress("poses of photos", 0.0, f"{len(sights)} photos")
    pairs = [(board.corners_M[seen.numbers], seen.pixels) for _, seen in sights]
    names = [path.name for path, _ in sights]
    guess = guess_lens(size, "opencv", pairs)
    lens, X_CM, noise = fit_lens(guess, [(name, *pair) for name, pair in zip(names, pairs, strict=True)])
    progress("poses of photos", 1.0, f"corners {noise:.2f} px off")
    shown = set(names)
    return PosedPhotos(
        names,
        np.array([X_WM @ inverse(X) for X in X_CM]),
        lens,
        noise,
        [path.name for path in paths if path.name not in shown],
    )


def write_photos(folder: Path, found: PosedPhotos, static: Path) -> None:
    """Write photos as static views of a capture: images of a pinhole, and `transforms.json`, which comes last.

    Raises:
        InputError: A photo cannot be read, or a file cannot be written.
    """
    camera, frames = pinhole_of(found.lens), list[tuple[str, Camera, Pose]]()
    remap = Remap(found.lens, camera)
    prepare_folder(static / "images")
    for name, X_WC in zip(found.names, found.X_WC, strict=True):
        seen = remap(np.ascontiguousarray(read_pixels(folder / name)[..., :3]))
        target = f"images/{Path(name).stem}.png"
        with replacing(static / target) as temporary:
            if not cv2.imwrite(str(temporary), cv2.cvtColor(seen, cv2.COLOR_RGB2BGR)):
                raise OSError("no image could be written")
        frames.append((target, camera, to_pose(X_WC)))
    write_posed_images(static / TRANSFORMS, frames)


def _sights(paths: Sequence[Path], board: Board, progress: Progress) -> tuple[list[tuple[Path, Seen]], tuple[int, int]]:
    """Photos that show the board, with its corners, and the size of all [px]."""
    detector, found, size = Detector(board), list[tuple[Path, Seen]](), (0, 0)
    for k, path in enumerate(paths):
        progress("looking for the board", k / len(paths), path.name)
        grey = read_grey(path)
        here = grey.shape[1], grey.shape[0]
        if k and here != size:
            allowed = f"{size[0]} x {size[1]} px, as {paths[0].name}"
            raise InputError(path, value=f"{here[0]} x {here[1]} px", allowed=allowed)
        size = here
        if (seen := detector.find(grey)) is not None:
            found.append((path, seen))
    return found, size


def _board_on_table(folder: Path, board: Board, thickness: float, station: Station) -> np.ndarray:
    """Pose X_WM (4, 4) of the board, put flat on the table of a station."""
    sights, size = _sights(photos_in(folder), board, lambda *_: None)
    if not sights:
        allowed = "a photo by the station's camera, with the board on the table"
        raise InputError(folder, value="no photo that shows the board", allowed=allowed)
    lens, table = station.lens, station.document.world.table.height + thickness
    if size != (lens.width, lens.height):
        allowed = f"{lens.width} x {lens.height} px, as {station.path} says"
        raise InputError(sights[0][0], value=f"{size[0]} x {size[1]} px", allowed=allowed)
    X_WC, flat = from_pose(station.X_WC), []
    for path, seen in sights:
        X_CM = locate(lens, board.corners_M[seen.numbers], seen.pixels)
        X_WM = X_WC @ X_CM if X_CM is not None else np.eye(4)
        tilt = float(np.arccos(np.clip(-X_WM[2, 2], -1.0, 1.0)))
        if tilt > _STEEPEST:
            found = f"a board that is tilted by {np.degrees(tilt):.1f} degrees"
            raise InputError(path, value=found, allowed="one that lies on the table, face up, by a camera that stands")
        flat.append(_flat(X_WM, X_WC[:3, 3], apply(X_WM, board.corners_M.mean(0)), table))
    places = np.array([X[:3, 3] for X in flat])
    if np.ptp(places, axis=0).max() > _STILL:
        found = f"a board that was moved by {1e3 * np.ptp(places, axis=0).max():.0f} mm"
        raise InputError(folder, value=found, allowed="a board that stays")
    return flat[0]


def _flat(X_WM: np.ndarray, p_WC: np.ndarray, middle: np.ndarray, height: float) -> np.ndarray:
    """Pose (4, 4) of a board on a table, whose middle (3,) [m] moves along the ray of the camera at p_WC (3,) [m]."""
    share = (height - p_WC[2]) / (middle[2] - p_WC[2])
    on_table = p_WC + share * (middle - p_WC)
    X = rigid(w=[0.0, 0.0, float(np.arctan2(X_WM[1, 0], X_WM[0, 0]))]) @ rigid(w=[np.pi, 0.0, 0.0])
    X[:3, 3] = on_table - X[:3, :3] @ (X_WM[:3, :3].T @ (middle - X_WM[:3, 3]))
    return X
