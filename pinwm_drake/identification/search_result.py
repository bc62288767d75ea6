"""Result of a search for the unknowns."""

from dataclasses import dataclass

from torch import Tensor

from pinwm_drake.identification.posterior import Posterior
from pinwm_drake.identification.problem import Problem
from pinwm_drake.identification.progress import Log
from pinwm_drake.spatial.poses import Pose


@dataclass(frozen=True, eq=False)
class Found:
    """Unknowns that a search found, with its losses and its log.

    Attributes:
        problem: The pushes, on the largest pictures.
        posterior: Draws of the unknowns, and what stands for them.
        loss: Mean square of the largest pictures, at the corrected poses.
        poses: X_WO by the model in the frames of each push: q (n, 4), p (n, 3) [m].
        corrections: The likeliest corrections of the poses in the frames of `problem`, of each push: (m, 6), rotation
            vectors [rad] and positions [m].
        coarse_losses: Losses of all starts after the coarse stage.
        start: Number of the start that led to the result.
        log: Every evaluation.
        seconds: Time taken, all runs together.
    """

    problem: Problem
    posterior: Posterior
    loss: float
    poses: list[Pose]
    corrections: list[Tensor]
    coarse_losses: list[float]
    start: int
    log: Log
    seconds: float
