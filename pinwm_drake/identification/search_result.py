"""Result of a search for the unknowns."""

from dataclasses import dataclass

from pinwm_drake.identification.problem import Problem
from pinwm_drake.identification.progress import Log
from pinwm_drake.identification.uncertainty import Posterior
from pinwm_drake.scene import Support
from pinwm_drake.spatial.poses import Pose


@dataclass(frozen=True, eq=False)
class Found:
    """Optimum that a search found, with its losses and its log.

    Attributes:
        support: The one that explains the video best.
        problem: The problem with that support.
        posterior: Gaussian around the optimum.
        loss: Mean square of the fine pictures.
        poses: X_WO in the frames: q (n, 4), p (n, 3) [m].
        losses: Mean squares by support: of those that came to the fine stage, after it or after polishing.
        coarse_losses: Losses of all supports after the coarse stage.
        log: Every evaluation.
        seconds: Time taken, all runs together.
    """

    support: Support
    problem: Problem
    posterior: Posterior
    loss: float
    poses: Pose
    losses: dict[Support, float]
    coarse_losses: dict[Support, float]
    log: Log
    seconds: float
