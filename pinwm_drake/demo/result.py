"""Results of the main demonstration, as its page shows them."""

from dataclasses import dataclass

from pinwm_drake.capture.episodes import ObjectPoses
from pinwm_drake.capture.scene import Capture
from pinwm_drake.demo.options import DemoOptions
from pinwm_drake.demo.policy import Performance
from pinwm_drake.demo.stages import Cost
from pinwm_drake.rendering.fitting import FitResult
from pinwm_drake.rendering.views import View
from pinwm_drake.report.twin.comparison_frames import Shot
from pinwm_drake.report.twin.score import PoseErrors
from pinwm_drake.twin.twin import Twin


@dataclass(frozen=True, eq=False)
class DemoPush:
    """A push of the capture as the camera saw it and as the twin has it.

    Attributes:
        name: Of the episode.
        poses: The twin's, at the frames.
        shots: The frames.
        errors: Of the poses; None where the truth is not known.
    """

    name: str
    poses: ObjectPoses
    shots: list[Shot]
    errors: PoseErrors | None


@dataclass(frozen=True, eq=False)
class DemoResult:
    """Everything that the page shows.

    Attributes:
        options: Capture, policy and budgets.
        capture: The capture.
        views: Its static views.
        fit: The surfels.
        twin: The twin.
        truth: True values of its parameters, by name.
        identified: The push that the twin was identified from.
        predicted: The push that it was not.
        performances: The policy in the twin and in the hydroelastic plant.
        costs: Of the stages, in their order.
        seconds: Wall time of all of them [s].
    """

    options: DemoOptions
    capture: Capture
    views: list[View]
    fit: FitResult
    twin: Twin
    truth: dict[str, float]
    identified: DemoPush
    predicted: DemoPush
    performances: list[Performance]
    costs: list[Cost]
    seconds: float
