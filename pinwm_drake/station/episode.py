# SPDX-License-Identifier: MIT
"""An episode of a capture from a film and a log of the pusher: one clock, the overlap of both, and masks."""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from pinwm_drake.capture.background import ALPHA
from pinwm_drake.capture.clock import EpisodeClock, write_clock
from pinwm_drake.capture.episode_tables import PusherTrajectory
from pinwm_drake.capture.importers.columns import make_trajectory, parse_columns
from pinwm_drake.capture.importers.film import Film, counted, is_epoch
from pinwm_drake.capture.importers.recordings import read_film, read_log
from pinwm_drake.capture.paths import is_file
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import EPISODES, Capture, load_capture
from pinwm_drake.capture.units import position_doubts, time_doubts
from pinwm_drake.capture.write import write_episode_tables
from pinwm_drake.errors import InputError
from pinwm_drake.files import appearing, prepare_folder, replacing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.station.clock.find import SPAN, find_clock
from pinwm_drake.station.clock.fine import ClockFit
from pinwm_drake.station.clock.patches import PusherFilm, box_of_way
from pinwm_drake.station.eye import Eye, read_eye

_AROUND = 0.5  # s of the log that are kept before the first and after the last image
_FEWEST = 8  # images of an episode
_LONGEST = 3000  # frames that are looked at
_GIVEN = 0.02  # s, standard deviation of an offset that was given
Report = Callable[[str, float], None]
"""Called with what is done and the share of it that is, 0 to 1."""


@dataclass(frozen=True, eq=False)
class Sources:
    """Files and options that an episode is made from; see `pinwm capture add-episode`.

    Attributes:
        video: Film.
        log: Log of the pusher; None where the film's recording has it too.
        columns: Map from the log's columns; empty to guess them.
        camera: File of the camera, as `camera.json`, or a `station.yaml`, whose log is in the robot's base; None for
            the camera of the capture's last episode.
        masks: Folder of masks or film of masks, one for each frame of the film; None for none.
        rate: Hz, of a film without time stamps.
        stamps: File of the images' times.
        topic: Topic, camera or channel of the images.
        log_topic: Topics or channel of the log.
        number: Number of an episode of a data set.
        start: s, of the film's own clock, from which frames are used; -inf for the first.
        end: s, up to which; inf for the last.
        offset: s, time of the log at time 0 of the film: None to find it, within 1.5 s of one clock for both.
        exact: Flag: `offset` is taken as it is; else it is the middle of the search.
    """

    video: Path
    log: Path | None = None
    columns: str = ""
    camera: Path | None = None
    masks: Path | None = None
    rate: float | None = None
    stamps: Path | None = None
    topic: str | None = None
    log_topic: str | None = None
    number: int = 0
    start: float = -np.inf
    end: float = np.inf
    offset: float | None = None
    exact: bool = False


@dataclass(frozen=True, eq=False)
class Added:
    """Episode that was added: its folder, clock, number of images, and whether these have masks."""

    folder: Path
    clock: EpisodeClock
    images: int
    masked: bool


def add_episode(
    path: Path,
    sources: Sources,
    *,
    name: str | None = None,
    aside: Path | None = None,
    finish: Callable[[Path], None] = lambda _: None,
    report: Report = lambda *_: None,
) -> Added:
    """Add an episode to a capture.

    The offset of the film's clock is found, frames and rows outside of the overlap are left out, and the log's times
    begin at 0.

    Args:
        path: The capture.
        sources: Film, log and options.
        name: Name of the episode; None for the next number.
        aside: New name of the folder of an earlier episode of this name; None to refuse one.
        finish: Called with the new folder when all is written to it, before it takes its name.
        report: Told of what goes on.

    Raises:
        InputError: A file cannot be read, film and log do not fit together, or they hardly overlap.
        ParameterError: An option or the column map is wrong, or a package is not installed.
    """
    capture = load_capture(path)
    name = name or f"{1 + max((int(one) for one in capture.episode_names if one.isdecimal()), default=-1):04}"
    given = parse_columns(sources.columns)
    film = _part(
        read_film(sources.video, rate=sources.rate, stamps=sources.stamps, topic=sources.topic, number=sources.number),
        sources,
    )
    log_path = sources.log or sources.video
    trajectory, notes = make_trajectory(read_log(log_path, topic=sources.log_topic, number=sources.number), given)
    notes = [*film.notes, *notes]
    first = next(film.frames([0]))
    eye = read_eye(capture, sources.camera, first)
    film, trajectory, camera, X_WC = eye.film(film), eye.log(trajectory), eye.camera, eye.X_WC
    if eye.lens is not None:
        notes.append("images freed of the lens's distortion; the log turned from the robot's base into W")
    fit = _offset(capture, film, trajectory, camera, X_WC, sources, notes, report)
    t = film.t * fit.rate + fit.offset
    inside = np.nonzero((t >= trajectory.t[0]) & (t <= trajectory.t[-1]))[0]
    if len(inside) < len(t):
        notes.append(f"{counted(len(t) - len(inside), 'frame')} outside of the log dropped")
    if len(inside) < _FEWEST:
        found = f"{counted(len(inside), 'frame')} within the log's {trajectory.t[-1] - trajectory.t[0]:.3g} s"
        raise InputError(sources.video, value=found, allowed=f"{_FEWEST} or more; film and log of the same push")
    trajectory = _trimmed(trajectory, float(t[inside[0]]), float(t[inside[-1]]), notes)
    begin = float(trajectory.t[0])
    clock = EpisodeClock(
        schema_version=1,
        offset=round(fit.offset, 6),
        deviation=round(fit.deviation, 6),
        interval=(round(fit.interval[0], 6), round(fit.interval[1], 6)),
        rate=fit.rate,
        start=begin,
        residual=None if np.isnan(fit.residual) else round(fit.residual, 3),
        film=str(sources.video),
        log=str(log_path),
        notes=tuple(notes),
    )
    trajectory = replace(trajectory, t=trajectory.t - begin)
    with appearing(prepare_folder(capture.folder / EPISODES) / name, aside) as folder:
        names = _write_images(folder, film, inside, report)
        masked = _write_masks(folder, sources.masks, film, inside, names, eye)
        masked |= first.shape[2] == 4
        write_episode_tables(folder, camera, X_WC, names, t[inside] - begin, trajectory, None)
        write_clock(folder, clock)
        finish(folder)
    folder = capture.folder / EPISODES / name
    _tell_doubts(capture, folder, t[inside] - begin, trajectory)
    return Added(folder, clock, len(names), masked)


def _part(film: Film, sources: Sources) -> Film:
    """Frames of a film between two times [s] from its start."""
    t = film.t - film.t[0]
    chosen = np.nonzero((t >= sources.start) & (t <= sources.end))[0]
    if len(chosen) < 2 or len(chosen) > _LONGEST:
        found = f"{counted(len(chosen), 'frame')} of a film of {t[-1]:.4g} s"
        raise InputError(film.path, value=found, allowed=f"{_FEWEST} to {_LONGEST}; --start and --end choose a part")
    frames = film.frames
    return replace(film, t=film.t[chosen], frames=lambda numbers: frames(chosen[list(numbers)].tolist()))


def _offset(
    capture: Capture,
    film: Film,
    trajectory: PusherTrajectory,
    camera: Camera,
    X_WC: Pose,
    sources: Sources,
    notes: list[str],
    report: Report,
) -> ClockFit:
    """Offset of the film's clock; see `find_clock`."""
    around, span, shared = 0.0, SPAN, film.shared and is_epoch(film.t) == is_epoch(trajectory.t)
    overlap = min(film.t[-1], trajectory.t[-1]) - max(film.t[0], trajectory.t[0])
    if sources.offset is not None:
        around = sources.offset
        if sources.exact:
            return ClockFit(around, _GIVEN, 1.0, float("nan"))
    elif shared and overlap < -SPAN:
        found = f"stamps of another clock: {film.t[0]:.3f} s to {film.t[-1]:.3f} s"
        log = f"{trajectory.t[0]:.3f} s to {trajectory.t[-1]:.3f} s"
        allowed = f"those of {sources.log or sources.video}, {log}; or --offset"
        raise InputError(film.path, value=found, allowed=allowed)
    elif not shared and overlap < 0.5 * (film.t[-1] - film.t[0]):
        # One of them counts from its own start: any place of the film in the log may be the right one.
        low, high = trajectory.t[0] - film.t[-1], trajectory.t[-1] - film.t[0]
        around, span = 0.5 * float(low + high), max(0.5 * float(high - low), SPAN)
        notes.append(f"clocks count from different starts; the film is looked for in {high - low:.3g} s of the log")
    bounds_P = np.array(pusher_surface(capture.pusher).bounds)
    x, y, width, height = box_of_way(trajectory.p_WP, camera, X_WC, bounds_P)
    report("reading", 0.0)
    frames = []
    for k, frame in enumerate(film.frames(range(len(film.t)))):
        frames.append(np.ascontiguousarray(frame[y : y + height, x : x + width, :3]))
        report("reading", (k + 1) / len(film.t))
    report("clock", 0.0)
    seen = PusherFilm(
        frames, film.t, trajectory.t, trajectory.p_WP, camera.cropped(x, y, width, height), X_WC, bounds_P
    )
    fit = find_clock(seen, film.path, around=around, span=span)
    report("clock", 1.0)
    if fit.rate != 1.0:
        notes.append(f"the film's clock drifts: {100 * (fit.rate - 1):+.2f} %, which its times are freed of")
    return fit


def _trimmed(log: PusherTrajectory, start: float, end: float, notes: list[str]) -> PusherTrajectory:
    """Rows of a log from a little before a time [s] to a little after another."""
    first = max(int(np.searchsorted(log.t, start - _AROUND, side="right")) - 1, 0)
    last = min(int(np.searchsorted(log.t, end + _AROUND)) + 1, len(log.t))
    if last - first < len(log.t):
        lost = counted(len(log.t) - last + first, "row")
        notes.append(f"{lost} of the log more than {_AROUND:g} s from the film dropped")
    force = None if log.force_W is None else log.force_W[first:last]
    return PusherTrajectory(log.t[first:last], log.p_WP[first:last], log.q_WP[first:last], log.v_WP[first:last], force)


def _write_images(folder: Path, film: Film, numbers: np.ndarray, report: Report) -> list[str]:
    names = []
    prepare_folder(folder / "rgb")
    for k, frame in enumerate(film.frames(numbers.tolist())):
        names.append(f"rgb/{k:05}.png")
        _write_picture(folder / names[-1], frame)
        report("writing", (k + 1) / len(numbers))
    return names


def _write_picture(path: Path, picture: np.ndarray) -> None:
    code = {2: None, 3: cv2.COLOR_RGB2BGR, 4: cv2.COLOR_RGBA2BGRA}[
        picture.ndim if picture.ndim == 2 else picture.shape[2]
    ]
    with replacing(path) as temporary:
        if not cv2.imwrite(str(temporary), picture if code is None else cv2.cvtColor(picture, code)):
            raise OSError("no image could be written")


def _write_masks(folder: Path, masks: Path | None, film: Film, numbers: np.ndarray, names: list[str], eye: Eye) -> bool:
    """Write the masks of frames; return whether there are any."""
    if masks is None:
        return False
    prepare_folder(folder / "masks")
    for name, mask in zip(names, _masks(masks, film, numbers, eye), strict=True):
        _write_picture(folder / "masks" / Path(name).name, mask)
    return True


def _masks(path: Path, film: Film, numbers: np.ndarray, eye: Eye) -> Iterator[np.ndarray]:
    """Masks (H, W) uint8 of frames, from a folder or film with one for each frame of the film."""
    found = read_film(path, rate=None if is_file(path) else film.rate)
    if len(found.t) != len(film.t):
        found_words = f"{counted(len(found.t), 'mask')}"
        raise InputError(path, value=found_words, allowed=f"{len(film.t)}, one for each frame of the film")
    brightest = 0
    for mask in found.frames(numbers.tolist()):
        eye.require_size(path, mask, "the size of the film")
        brightest = max(brightest, int(mask[..., :3].max()))
        yield np.where(eye.seen(mask[..., :3], outside=0).max(-1) >= ALPHA, 255, 0).astype(np.uint8)
    if brightest < ALPHA:  # as `read_mask` has it for a single one
        allowed = f"0, and {ALPHA} to 255 on the object"
        raise InputError(path, value=f"masks whose largest value is {brightest}", allowed=allowed)


def _tell_doubts(capture: Capture, folder: Path, t: np.ndarray, trajectory: PusherTrajectory) -> None:
    mesh, X_WO = load_mesh(capture.object.mesh_path), capture.object.X_WO
    doubts = time_doubts(folder, t, trajectory)
    doubts += position_doubts(folder, trajectory, mesh, X_WO, pusher_surface(capture.pusher))
    for doubt in doubts:
        warnings.warn(str(doubt), UserWarning, stacklevel=3)
