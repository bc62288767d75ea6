# SPDX-License-Identifier: MIT
"""Poses of the object in every frame, given the unknowns: the physics half of the world model."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.capture.episodes import Episode
from pinwm_drake.errors import SolverError
from pinwm_drake.identification.unknowns import BODIES
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.scene import (
    PusherMotion,
    Scene,
    pusher_motions,
    resting_height,
    rollout_poses,
    scaled_inertia,
    scene_parameters,
    step_count,
)
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_multiply
from pinwm_drake.twin.frame import FRAME, moved_motion
from pinwm_drake.twin.kicks import Kicks, carried_kicks
from pinwm_drake.twin.rollout import pusher_impulses

_Found = TypeVar("_Found")
# Half the difference quotient's step by which a shift in time turns into velocities [s].
_TIME_STEP = 1e-4


@dataclass(frozen=True, eq=False)
class Forward:
    """Rolls out an episode for W values of the unknowns at once.

    The floor stays where the model has it: `lift` raises what comes out, and lowers the pusher that goes in.
    """

    scene: Scene
    episode: Episode  # Times of the frames, and the pusher's trajectory
    X_WO: Pose  # Pose at the start, as it is known; q (4,), p (3,) [m]
    mass: float  # Nominal mass that inertias count with, kg
    num_threads: int  # of the physics
    chosen: Tensor | None = None  # (m,), indices of the frames whose poses are wanted; None for all n
    pivot: Tensor | None = None  # (3,) [m], about which the frame of the robot turns; None for the start

    @property
    def times(self) -> np.ndarray:
        """Times (n,) [s] of the wanted frames."""
        return self.episode.times if self.chosen is None else self.episode.times[self.chosen.numpy()]

    def poses(self, values: dict[str, Tensor]) -> tuple[Pose, Tensor]:
        """Poses of the object in the frames.

        Args:
            values: (W,) for each of `UNKNOWNS`, physical.

        Returns:
            q_WO (n, W, 4), p_WO (n, W, 3) [m], differentiable in the values; and (W,) bool, false for worlds whose
            physics found no solution: there the poses are those of the start.
        """
        W = len(values["mass"])
        alive = torch.ones(W, dtype=torch.bool)
        try:
            return self._rollout(values), alive
        except SolverError as error:
            if not error.worlds:
                raise
            alive[list(error.worlds)] = False
        n, rows = len(self.times), torch.nonzero(alive)[:, 0]
        q, p = self.X_WO.q.expand(n, W, 4), self.X_WO.p.expand(n, W, 3)
        if len(rows):
            X_WO = self._rollout({name: value[rows] for name, value in values.items()})
            q, p = q.index_copy(1, rows, X_WO.q), p.index_copy(1, rows, X_WO.p)
        return Pose(q, p), alive

    def shown(self, values: dict[str, Tensor]) -> tuple[Pose, Tensor]:
        """Poses of the object as the camera shows them: those of `poses`, moved by `view_x`, `view_y` and `view_z`."""
        X_WO, alive = self.poses(values)
        view = torch.stack([values[f"view_{axis}"] for axis in "xyz"], -1)
        return Pose(X_WO.q, X_WO.p + view), alive

    def kicks(self, values: dict[str, Tensor]) -> Kicks:
        """Return what errors of changes of velocity make of the poses; see `twin/kicks.py`."""
        return self._rolled(carried_kicks, values)[0]

    def parameters(self, values: dict[str, Tensor]) -> Parameters:
        """Parameters theta of W worlds."""
        changed = {
            **values,
            **{f"friction_{body}": values[f"friction_{body}"] * values[f"grip_{body}"] for body in BODIES},
            **{f"restitution_{body}": values[f"restitution_{body}"].clamp(0.0, 1.0) for body in BODIES},
        }
        return scene_parameters(changed, inertia(self.scene, self.mass, values))

    @torch.no_grad()
    def pusher_impulses(self, values: dict[str, Tensor]) -> tuple[np.ndarray, np.ndarray]:
        """Impulses of the object on the pusher, step by step.

        Args:
            values: As for `poses`.

        Returns:
            Times (T + 1, W) [s] by the clock of the pusher's log at which steps begin and end, and impulses (T, W, 3)
            [N s], axes of the log.

        Raises:
            SolverError: The physics found no solution in one of the worlds.
        """
        X_WO, motion, _ = self._start(values)
        impulses = pusher_impulses(self.scene, self.parameters(values), X_WO, motion, num_threads=self.num_threads)
        after = self.scene.model.time_step * np.arange(len(impulses) + 1)
        first = float(self.episode.times.min()) + values["time_offset"].detach().numpy()
        turned = values["frame_yaw"].detach().numpy()
        back = np.stack([np.cos(turned), np.sin(turned), -np.sin(turned), np.cos(turned)], -1).reshape(-1, 2, 2)
        impulses[..., :2] = np.einsum("wij,twj->twi", back, impulses[..., :2])
        return after[:, None] + first, impulses

    def _rollout(self, values: dict[str, Tensor]) -> Pose:
        found, up = self._rolled(rollout_poses, values)
        return Pose(found.q, found.p + up)

    def _rolled(self, function: Callable[..., _Found], values: dict[str, Tensor]) -> tuple[_Found, Tensor]:
        """What a function with the arguments of `rollout_poses` returns, and by how much (W, 3) [m] poses rise."""
        X_WO, motion, up = self._start(values)
        found = function(
            self.scene,
            self.parameters(values),
            X_WO,
            motion,
            torch.from_numpy(self.times - self.episode.times.min()),
            V_WO=self.episode.start_velocity,
            num_threads=self.num_threads,
        )
        return found, up

    def _start(self, values: dict[str, Tensor]) -> tuple[Pose, PusherMotion, Tensor]:
        """Pose at the start on the model's floor, the pusher's motion over it, and by how much (W, 3) [m] both rise."""
        W = len(values["mass"])
        z = torch.zeros(W, dtype=torch.float64)
        turn = quaternion_exp(torch.stack([z, z, values["start_yaw"]], -1))
        q_WO = quaternion_multiply(turn, self.X_WO.q.expand(W, 4))
        thrown = self.episode.start_velocity is not None
        rest = float(self.X_WO.p[2]) if thrown else resting_height(self.scene, self.X_WO.q)
        # What is thrown starts where it was seen, over a floor that is raised.
        height = rest - values["lift"] if thrown else z + rest
        p_WO = torch.stack([self.X_WO.p[0] + values["start_x"], self.X_WO.p[1] + values["start_y"], height], -1)
        raised = float(self.X_WO.p[2]) - rest + values["lift"]
        up = torch.stack([z, z, raised], -1)
        motion = self._motion(values["time_offset"])
        frame = torch.stack([values[name] for name in FRAME], -1)
        if frame.requires_grad or bool(frame.any()):
            motion = moved_motion(motion, frame, self.X_WO.p if self.pivot is None else self.pivot)
        return Pose(q_WO, p_WO), PusherMotion(motion.q_WP, motion.p_WP - up, motion.V_WP), up

    def _motion(self, offset: Tensor) -> PusherMotion:
        """Return the pusher's motion (T, W, 6), each world's shifted in time by its offset (W,) [s]; differentiable."""
        h = self.scene.model.time_step
        t = self.episode.times
        first, steps = float(t.min()), step_count(t.max() - t.min(), h)

        shifts = offset.detach().numpy()
        same = len(np.unique(shifts)) == 1

        def at(shift: float) -> PusherMotion:
            times = first + shift + (shifts[:1] if same else shifts)
            return pusher_motions(self.episode.trajectory, times, steps, h)

        motion, W = at(0.0), len(shifts)
        motion = PusherMotion(motion.q_WP.expand(W, 4), motion.p_WP.expand(W, 3), motion.V_WP.expand(steps, W, 6))
        if not offset.requires_grad:
            return motion
        moved = (offset - offset.detach())[:, None]
        before, after = at(-_TIME_STEP), at(_TIME_STEP)
        rate_p = (after.p_WP - before.p_WP) / (2.0 * _TIME_STEP)
        rate_V = (after.V_WP - before.V_WP) / (2.0 * _TIME_STEP)
        return PusherMotion(motion.q_WP, motion.p_WP + moved * rate_p, motion.V_WP + moved * rate_V)


def inertia(scene: Scene, mass: float, values: dict[str, Tensor]) -> Tensor:
    """Inertia with the factors `moment_*` of a guess, (..., 3, 3) [kg m^2]; see `scaled_inertia`."""
    factors = torch.stack([values["moment_xx"], values["moment_yy"], values["moment_zz"]], -1)
    return scaled_inertia(scene, mass, factors)
