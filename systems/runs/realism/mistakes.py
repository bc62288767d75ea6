# SPDX-License-Identifier: MIT
"""Mistakes of a capture as a lab has them, of engines no concern: of its poses, cameras and clocks."""

import math
from dataclasses import dataclass, replace

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from pinwm_drake.capture.episodes import PusherTrajectory

MARGIN = 0.05  # s, by which a log is longer than the video at both ends


@dataclass(frozen=True)
class Realism:
    """Sizes of the mistakes of a capture.

    Attributes:
        start_place: m, standard deviation of the start pose that is written, along x and y of the floor.
        start_turn: rad, standard deviation of its turn about the vertical.
        episode_place: m, standard deviation of the place of an episode's camera that is written, along each axis.
        episode_turn: rad, standard deviation of its turn about each axis.
        static_place: m, that of a static view's camera.
        static_turn: rad, that of a static view's camera.
        clock: s, by which a pusher's log is early or late at the most, either way.
        mask: px, by which masks are too small or too large at the most.
        flicker: px, standard deviation of that from one frame to the next.
        exposure: s, of a picture; its time is that of the middle.
    """

    start_place: float = 0.005 / math.sqrt(2)
    start_turn: float = math.radians(3)
    episode_place: float = 0.003 / math.sqrt(3)
    episode_turn: float = math.radians(0.5) / math.sqrt(3)
    static_place: float = 0.0005 / math.sqrt(3)
    static_turn: float = math.radians(0.1) / math.sqrt(3)
    clock: float = 0.030
    mask: float = 1.5
    flicker: float = 0.5
    exposure: float = 0.015


def moved_on_floor(X_WO: RigidTransform, place: float, turn: float, generator: np.random.Generator) -> RigidTransform:
    """Pose of an object that was measured wrongly on the floor: its height and tilt are right.

    Args:
        X_WO: The true pose.
        place: m, standard deviation along x and y of the world.
        turn: rad, standard deviation of the turn about the vertical through O.
        generator: Source of randomness.
    """
    angle, x, y = generator.normal(0.0, [turn, place, place])
    return RigidTransform(
        RotationMatrix.MakeZRotation(angle) @ X_WO.rotation(), X_WO.translation() + np.array([x, y, 0.0])
    )


def moved_camera(X_WC: RigidTransform, place: float, turn: float, generator: np.random.Generator) -> RigidTransform:
    """Pose of a camera that was calibrated wrongly, by standard deviations [m, rad] along and about each axis."""
    shift = generator.normal(0.0, place, 3)
    R = RollPitchYaw(generator.normal(0.0, turn, 3)).ToRotationMatrix()
    return RigidTransform(X_WC.rotation() @ R, X_WC.translation() + shift)


def late_log(log: PusherTrajectory, late: float, margin: float) -> PusherTrajectory:
    """Log of a pusher whose clock is not the camera's.

    Args:
        log: The log by the camera's clock; the pusher rests at both of its ends.
        late: s, added to all of its times.
        margin: s, by which the log is made longer at both ends, so that it still covers all pictures.
    """
    t = np.concatenate([[log.t[0] - margin], log.t, [log.t[-1] + margin]]) + late
    ends = ((1, 1), (0, 0))
    p_WP, q_WP = (np.pad(values, ends, mode="edge") for values in (log.p_WP, log.q_WP))
    force_W = None if log.force_W is None else np.pad(log.force_W, ends, mode="edge")
    v_WP = np.pad(log.v_WP, ends)
    return replace(log, t=t, p_WP=p_WP, q_WP=q_WP, v_WP=v_WP, force_W=force_W)
