"""`pinwm capture simulate`: a bar of the images."""

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.systems.runs.capture_options import SimulateCaptureRequest


def simulate(request: SimulateCaptureRequest) -> None:
    """Makes a capture from Drake: a stand-in for a robot that pushes an object in front of a camera."""
    from pinwm_drake.systems.runs.simulated_capture import simulate_capture

    with stages_bar() as progress:
        simulate_capture(request.options, request.out, progress=progress)
    say(f"wrote {request.out}")
