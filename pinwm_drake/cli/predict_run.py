"""What `pinwm predict` does."""

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from pinwm_drake.capture.episodes import Episode, ObjectPoses, read_episode_folder
from pinwm_drake.capture.scene import Capture, PusherGeometry
from pinwm_drake.capture.write import write_pose_table
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import prepare_folder
from pinwm_drake.report.captions import write_panel_captions
from pinwm_drake.report.evaluation.pictures import Cast
from pinwm_drake.report.twin.comparison_frames import PANELS, Shot, draw_shots
from pinwm_drake.report.twin.score import pose_errors
from pinwm_drake.report.video import write_video
from pinwm_drake.twin import Twin, read_twin
from pinwm_drake.twin.origin import is_identified_episode, start_pose, time_offset
from pinwm_drake.twin.rollout import rollout

_PANEL = 480  # px
# What is taken for rounding: of gravity [m/s^2], and of a floor on which the object was said to rest [m].
_SAME_GRAVITY, _SAME_FLOOR = 1e-3, 1e-3
_RATES = (4.0, 60.0)  # 1/s, of a film; real time where the frames allow it


def run_predict(twin_path: Path, episode_path: Path, out: Path, video: Path | None) -> None:
    """Predicts an episode.

    Args:
        twin_path: The twin's folder.
        episode_path: `CAPTURE/episodes/NAME`.
        out: File of the poses.
        video: File of the film, or None.

    Raises:
        PinwmError: An input was refused, the physics found no solution, or a file cannot be written.
    """
    if video is not None and video.suffix.lower() != ".mp4":
        raise ParameterError(f"--video: got {video}; allowed: a name that ends in .mp4")
    twin = read_twin(twin_path)
    capture, episode = read_episode_folder(episode_path)
    for path in (out, video):
        if path is not None:
            _require_free(path, episode)
    console, errors = Console(), Console(stderr=True, soft_wrap=True)
    for warning in mismatches(twin, capture):
        errors.print(f"warning: {warning}", highlight=False, markup=False)
    identified = is_identified_episode(twin, capture, episode)
    poses = predict_poses(twin, capture, episode, identified=identified)
    write_pose_table(out, poses)
    for line in _summary(poses, capture, episode):
        console.print(line, highlight=False, soft_wrap=True, markup=False)
    console.print(f"wrote {out}", highlight=False, soft_wrap=True, markup=False)
    if video is not None:
        _film(video, twin, episode, poses, identified, console)
        console.print(f"wrote {video}", highlight=False, soft_wrap=True, markup=False)


def predict_poses(twin: Twin, capture: Capture, episode: Episode, *, identified: bool) -> ObjectPoses:
    """Where the twin says the object is at the frames of an episode.

    Args:
        twin: The twin.
        capture: The capture of the episode, which says where the object starts.
        episode: The episode; of it, the pusher's log and the times of the frames are used.
        identified: Whether it is the episode that the twin was identified from.

    Returns:
        The poses at `episode.t`.

    Raises:
        PinwmError: A mesh cannot be used, or the physics found no solution.
    """
    start, late = start_pose(twin, capture, identified=identified), time_offset(twin, identified=identified)
    found = rollout(_in_place_of(twin, capture), start, episode.trajectory, episode.t + late)
    return ObjectPoses(episode.t, found.p_WO, found.q_WO)


def mismatches(twin: Twin, capture: Capture) -> list[str]:
    """In what a capture's scene differs from that of the twin, in words."""
    found = []
    if _digest(twin.mesh_path) != _digest(capture.object.mesh_path):
        found.append(f"the twin's mesh is another one than {capture.object.mesh_path}; the twin's is used")
    if not _same_pusher(twin.pusher, capture.pusher):
        found.append(f"the twin's pusher is another one than that of {capture.folder}; the twin's is used")
    if abs(twin.gravity - capture.gravity) > _SAME_GRAVITY:
        found.append(
            f"gravity is {twin.gravity:g} m/s² in the twin; the {capture.gravity:g} m/s² of the capture are used"
        )
    ours, theirs = 1e3 * (twin.floor_height - _lift(twin)), 1e3 * capture.floor_height
    if abs(ours - theirs) > 1e3 * _SAME_FLOOR:
        found.append(f"the floor is {ours:.1f} mm high in the twin; the {theirs:.1f} mm of the capture are used")
    return found


def _in_place_of(twin: Twin, capture: Capture) -> Twin:
    """The twin with the gravity of a capture and, unless it is the same but for the lift, on its floor."""
    floor = capture.floor_height + _lift(twin)
    same = abs(twin.floor_height - floor) <= _SAME_FLOOR
    return replace(twin, gravity=capture.gravity, floor_height=twin.floor_height if same else floor)


def _lift(twin: Twin) -> float:
    return twin.nuisance["lift"].value if "lift" in twin.nuisance else 0.0


def _same_pusher(twin: PusherGeometry, capture: PusherGeometry) -> bool:
    if twin.shape is not None or capture.shape is not None:
        return twin.shape == capture.shape
    if twin.mesh_path is None or capture.mesh_path is None:
        return twin.mesh_path == capture.mesh_path
    return _digest(twin.mesh_path) == _digest(capture.mesh_path)


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(path, value=error.strerror, allowed="a file that can be read") from error


def _require_free(path: Path, episode: Episode) -> None:
    """Makes the folder of a result; raises InputError where it would replace a folder or a file of the capture."""
    if path.is_dir():
        raise InputError(path, value="a folder", allowed="a file")
    if path.exists() and path.resolve().is_relative_to(episode.folder.resolve()):
        raise InputError(path, value="a file of the episode", allowed="a new file, or one outside of the episode")
    prepare_folder(path.parent)


def _summary(poses: ObjectPoses, capture: Capture, episode: Episode) -> list[str]:
    """What was predicted and, where the truth is known, how far off it is."""
    moved = 1e3 * float(np.linalg.norm(poses.p_WO[-1] - poses.p_WO[0]))
    share = min(float(np.abs(poses.q_WO[-1] @ poses.q_WO[0])), 1.0)
    turned = float(np.degrees(2 * np.arccos(share)))
    seconds = float(poses.t[-1] - poses.t[0])
    frames = f"{len(poses.t)} frames in {seconds:.2f} s"
    lines = [
        f"{capture.object.name}, episode {episode.name}: {frames}; moves by {moved:.1f} mm, turns by {turned:.1f}°"
    ]
    errors = None if episode.object_poses is None else pose_errors(poses, episode.object_poses)
    if errors is None:
        lines.append("score: none, as the episode has no object_poses.csv for these times")
    else:
        lines.append(f"score against object_poses.csv ({len(errors.t)} frames): {errors.words()}")
    return lines


def _film(path: Path, twin: Twin, episode: Episode, poses: ObjectPoses, identified: bool, console: Console) -> None:
    """Films camera, twin and difference, in real time where the rate allows it."""
    cast = Cast.of(twin, identified=identified)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("filming", total=1.0)

        def report(share: float) -> None:
            progress.update(task, completed=share)

        shots = draw_shots(episode, poses, cast, size=_PANEL, most=len(episode.t), report=report)
    seconds = float(episode.t[-1] - episode.t[0])
    rate = float(np.clip((len(episode.t) - 1) / seconds if seconds > 0 else _RATES[0], *_RATES))
    height, width = shots[0].joined().shape[:2]
    write_video(path, _frames(shots), rate=rate, size=(width, height))


def _frames(shots: list[Shot]) -> Iterator[np.ndarray]:
    for shot in shots:
        frame = shot.joined().copy()
        write_panel_captions(frame, [f"{PANELS[0]}  t = {shot.t:.2f} s", *PANELS[1:]])
        yield frame
