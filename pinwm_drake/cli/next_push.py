# SPDX-License-Identifier: MIT
"""`pinwm next-push`: a bar, and what the push is expected to tell."""

import math

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.experiments.requests.twins import NextPushRequest


def next_push(request: NextPushRequest) -> None:
    """Propose the push whose video tells most about a twin.

    It also says when no further push is needed. After pokes it proposes a poke. Of a capture without pushes it
    proposes the first one.

    Film it, add it to the capture as an episode, and identify from all of them:
    pinwm identify CAPTURE TWIN --episode A --episode B.
    """
    from pinwm_drake.experiments.next_push import filmed_motion, next_push
    from pinwm_drake.experiments.proposal import describe, write_proposal
    from pinwm_drake.files import prepare_folder
    from pinwm_drake.identification.prior import capture_without_pushes, prior_twin
    from pinwm_drake.twin.read import load_twin

    capture, (low, high) = capture_without_pushes(request.twin), request.box
    found = load_twin(request.twin) if capture is None else prior_twin(capture)
    with stages_bar(transient=True) as progress:
        proposal = next_push(
            found,
            X_WO=None if capture is None else capture.object.X_WO,
            motion=request.motion or (filmed_motion(found) if capture is None else "push"),
            low=low,
            high=high,
            number=request.candidates,
            draws=request.draws,
            tolerance=(1e-3 * request.position, math.radians(request.yaw)),
            seed=request.seed,
            report=lambda share: progress("pushing", share, ""),
        )
    prepare_folder(request.out)
    files = write_proposal(request.out, found, proposal)
    for line in describe(found, proposal):
        say(line)
    for path in files:
        say(f"wrote {path}")
