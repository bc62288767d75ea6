# SPDX-License-Identifier: MIT
"""`pinwm next-push`: a bar, and what the push is expected to tell."""

import math

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.experiments.requests.twins import NextPushRequest


def next_push(request: NextPushRequest) -> None:
    """Propose the push whose video tells most about a twin.

    It also says when no further push is needed.

    Film it, add it to the capture as an episode, and identify from all of them:
    pinwm identify CAPTURE TWIN --episode A --episode B.
    """
    from pinwm_drake.experiments.next_push import next_push, write_proposal
    from pinwm_drake.files import prepare_folder
    from pinwm_drake.twin.read import load_twin

    found = load_twin(request.twin)
    with stages_bar(transient=True) as progress:
        proposal = next_push(
            found,
            low=request.low,
            high=request.high,
            number=request.candidates,
            draws=request.draws,
            tolerance=(1e-3 * request.position, math.radians(request.yaw)),
            seed=request.seed,
            report=lambda share: progress("pushing", share, ""),
        )
    prepare_folder(request.out)
    files = write_proposal(request.out, found, proposal)
    best, (mm, turn) = proposal.candidates[0], proposal.spread
    motion = best.motion
    angle = math.degrees(math.atan2(motion.direction_W[1], motion.direction_W[0]))
    start = ", ".join(f"{1e3 * x:.0f}" for x in motion.p_WP)
    say(f"nine of ten random pushes end within {1e3 * mm:.1f} mm and {math.degrees(turn):.1f}° (standard deviation)")
    if proposal.is_good_enough:
        say("that is good enough: a further push would hardly change what the twin predicts")
    say(
        f"the push that tells most starts at ({start}) mm towards {angle:.0f}°, {1e3 * motion.speed:.0f} mm/s for "
        f"{1e3 * motion.distance:.0f} mm: {best.information:.1f} nats, spread {1e3 * best.position:.1f} mm and "
        f"{math.degrees(best.yaw):.1f}°"
    )
    for path in files:
        say(f"wrote {path}")
