# SPDX-License-Identifier: MIT
"""`pinwm predict`: bars, and the prediction in a few lines."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from pinwm_drake.cli.console import say, stages_bar, warn
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.requests.twins import PredictRequest

if TYPE_CHECKING:
    from pinwm_drake.experiments.prediction import Prediction


def predict(request: PredictRequest) -> None:
    """Predict the motion of an episode from its pusher log.

    Where the episode has object_poses.csv, the error of the prediction is printed.
    """
    from pinwm_drake.capture.write import write_pose_table
    from pinwm_drake.experiments.prediction import predict as run
    from pinwm_drake.files import prepare_folder, replacing
    from pinwm_drake.report.twin.prediction_film import write_prediction_film

    for path in (request.out, request.plot, request.video):
        if path is not None:
            _require_free(path, request.episode)
    with stages_bar(transient=True) as show:
        found = run(request.twin, request.episode, find_start=request.find_start, progress=show)
    for warning in found.warnings:
        warn(warning)
    for path in (request.out, request.plot, request.video):
        if path is not None:
            prepare_folder(path.parent)
    write_pose_table(request.out, found.poses)
    for line in _summary(found):
        say(line)
    say(f"wrote {request.out}")
    push, poses, spread = found.episode, found.poses, found.spread
    if request.plot is not None:
        with replacing(request.plot) as temporary:
            found.figure().savefig(temporary, format="png")
        say(f"wrote {request.plot}")
    if request.video is not None:
        with stages_bar(transient=True) as show:
            write_prediction_film(
                request.video,
                found.twin,
                push,
                poses,
                found.push,
                spread=spread,
                report=lambda share: show("filming", share, ""),
            )
        say(f"wrote {request.video}")


def _require_free(path: Path, episode: Path) -> None:
    """Raise InputError where a result would replace a folder or a file of the episode."""
    if path.is_dir():
        raise InputError(path, value="a folder", allowed="a file")
    if path.exists() and path.resolve().is_relative_to(episode.resolve()):
        raise InputError(path, value="a file of the episode", allowed="a new file, or one outside of the episode")


def _summary(found: "Prediction") -> list[str]:
    """Lines on the predicted motion and, where the truth is known, its error."""
    from pinwm_drake.report.twin.score import pose_errors
    from pinwm_drake.twin.predict import TWO_SIDED

    poses, spread, episode, capture = found.poses, found.spread, found.episode, found.capture
    lines = []
    if found.start is not None:
        place, turn = found.start_shift
        lines.append(
            f"the object starts {1e3 * place:.1f} mm and {math.degrees(turn):.1f}° away from the pose in capture.yaml"
        )
    moved, turned = found.motion
    frames = f"{len(poses.t)} frames in {float(poses.t[-1] - poses.t[0]):.2f} s"
    lines.append(
        f"{capture.object.name}, episode {episode.name}: {frames}; "
        f"moves by {1e3 * moved:.1f} mm, turns by {math.degrees(turned):.1f}°"
    )
    if spread is not None:
        x, y = (1e3 * TWO_SIDED * float(values[-1]) for values in (spread.x, spread.y))
        yaw = TWO_SIDED * math.degrees(float(spread.yaw[-1]))
        lines.append(f"95 % of such pushes end within ±{x:.1f} mm in x, ±{y:.1f} mm in y and ±{yaw:.1f}° of that")
    errors = None if episode.object_poses is None else pose_errors(poses, episode.object_poses)
    if errors is None:
        lines.append("score: none, as the episode has no object_poses.csv for these times")
    else:
        lines.append(f"score against object_poses.csv ({len(errors.t)} frames): {errors.words()}")
    return lines
