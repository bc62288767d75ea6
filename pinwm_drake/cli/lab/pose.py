# SPDX-License-Identifier: MIT
"""`pinwm pose`: the pose at the start in words."""

from pinwm_drake.cli.console import say
from pinwm_drake.experiments.requests.lab import PoseRequest


def pose(request: PoseRequest) -> None:
    """Find the pose of a mesh in the static views, without a guess.

    Resting faces and yaws are searched; the masks say which one is right.
    """
    from pinwm_drake.experiments.start import start_pose, write_pose

    found = start_pose(request.folder, poses=request.poses, view=request.view)
    X_WO = found.X_WO
    place = ", ".join(f"{1e3 * x:.1f}" for x in X_WO.p.tolist())
    turn = ", ".join(f"{x:.4f}" for x in X_WO.q.tolist())
    say(f"object at ({place}) mm, q ({turn}), from {found.views} view{'s' if found.views > 1 else ''}")
    for line in found.words():
        say(line, style="yellow" if line.startswith("doubtful") else None)
    if request.write:
        for line in write_pose(request.folder, X_WO):
            say(line, style="yellow")
        instead = "" if found.before is None else ", in place of the one that was there"
        say(f"wrote object.X_WO to {request.folder / 'capture.yaml'}{instead}")
