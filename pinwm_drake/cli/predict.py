"""`pinwm predict`: options, and the prediction in a few lines."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.errors import InputError, require
from pinwm_drake.files import prepare_folder, replacing

if TYPE_CHECKING:
    from pinwm_drake.capture.episodes import Episode, ObjectPoses
    from pinwm_drake.capture.scene import Capture
    from pinwm_drake.spatial.poses import Pose
    from pinwm_drake.twin.predict import Spread


def predict(
    twin: Annotated[Path, typer.Argument(metavar="TWIN", help="Folder that `pinwm identify` wrote.")],
    episode: Annotated[
        Path, typer.Argument(metavar="EPISODE", help="CAPTURE/episodes/NAME, of this capture or another one.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="File of the poses, as object_poses.csv has them.")],
    find_start: Annotated[
        bool,
        typer.Option(
            "--find-start",
            help="Look for the object in the first picture; else it is where capture.yaml says.",
        ),
    ] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Draw the motion over time, with its 95 % band, to this .png file.")
    ] = None,
    video: Annotated[
        Path | None, typer.Option(help="Film camera, twin and difference side by side to this .mp4 file.")
    ] = None,
) -> None:
    """Rolls a twin out along an episode's pusher log; with object_poses.csv there, says how far off it is."""
    from pinwm_drake.capture.episodes import read_episode_folder
    from pinwm_drake.capture.write import write_pose_table
    from pinwm_drake.identification.locate import locate
    from pinwm_drake.report.figures.poses import motion_figure
    from pinwm_drake.report.twin.prediction_film import write_prediction_film
    from pinwm_drake.twin.origin import identified_push, start_pose
    from pinwm_drake.twin.predict import mismatches, predict_poses, predict_spread
    from pinwm_drake.twin.read import read_twin

    require("--plot", plot, plot is None or plot.suffix.lower() == ".png", "a name that ends in .png")
    require("--video", video, video is None or video.suffix.lower() == ".mp4", "a name that ends in .mp4")
    found = read_twin(twin)
    capture, push = read_episode_folder(episode)
    for path in (out, plot, video):
        if path is not None:
            _require_free(path, push)
    errors = Console(stderr=True, soft_wrap=True)
    for warning in mismatches(found, capture):
        errors.print(f"warning: {warning}", highlight=False, markup=False)
    number = identified_push(found, capture, push)
    start = locate(found, push, start_pose(found, capture, number)) if find_start else None
    poses = predict_poses(found, capture, push, number, start=start)
    spread = predict_spread(found, capture, push, number, start=start)
    write_pose_table(out, poses)
    if start is not None:
        say(_shift(start, capture.object.X_WO))
    for line in _summary(poses, capture, push, spread):
        say(line)
    say(f"wrote {out}")
    if plot is not None:
        with replacing(plot) as temporary:
            motion_figure(poses, push.object_poses, push.trajectory, spread).savefig(temporary, format="png")
        say(f"wrote {plot}")
    if video is not None:
        with stages_bar(transient=True) as show:
            write_prediction_film(
                video, found, push, poses, number, spread=spread, report=lambda share: show("filming", share, "")
            )
        say(f"wrote {video}")


def _require_free(path: Path, episode: "Episode") -> None:
    """Makes the folder of a result; raises InputError where it would replace a folder or a file of the capture."""
    if path.is_dir():
        raise InputError(path, value="a folder", allowed="a file")
    if path.exists() and path.resolve().is_relative_to(episode.folder.resolve()):
        raise InputError(path, value="a file of the episode", allowed="a new file, or one outside of the episode")
    prepare_folder(path.parent)


def _shift(start: "Pose", written: "Pose") -> str:
    """Line that tells how far a pose that was found is from the one that is written."""
    from pinwm_drake.spatial.rotations import turn_between

    place = 1e3 * float((start.p - written.p)[:2].norm())
    turn = math.degrees(float(turn_between(written.q, start.q)[2]))
    return f"the object starts {place:.1f} mm and {turn:.1f}° away from the pose in capture.yaml"


def _summary(poses: "ObjectPoses", capture: "Capture", episode: "Episode", spread: "Spread | None") -> list[str]:
    """Lines on the predicted motion and, where the truth is known, its error."""
    import numpy as np

    from pinwm_drake.report.twin.score import pose_errors
    from pinwm_drake.twin.predict import TWO_SIDED

    moved = 1e3 * float(np.linalg.norm(poses.p_WO[-1] - poses.p_WO[0]))
    share = min(float(np.abs(poses.q_WO[-1] @ poses.q_WO[0])), 1.0)
    turned = float(np.degrees(2 * np.arccos(share)))
    seconds = float(poses.t[-1] - poses.t[0])
    frames = f"{len(poses.t)} frames in {seconds:.2f} s"
    lines = [
        f"{capture.object.name}, episode {episode.name}: {frames}; moves by {moved:.1f} mm, turns by {turned:.1f}°"
    ]
    if spread is not None:
        x, y = (1e3 * TWO_SIDED * float(values[-1]) for values in (spread.x, spread.y))
        turn = TWO_SIDED * float(np.degrees(spread.yaw[-1]))
        lines.append(f"95 % of such pushes end within ±{x:.1f} mm in x, ±{y:.1f} mm in y and ±{turn:.1f}° of that")
    errors = None if episode.object_poses is None else pose_errors(poses, episode.object_poses)
    if errors is None:
        lines.append("score: none, as the episode has no object_poses.csv for these times")
    else:
        lines.append(f"score against object_poses.csv ({len(errors.t)} frames): {errors.words()}")
    return lines
