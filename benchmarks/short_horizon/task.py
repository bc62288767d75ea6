"""State and shaped reward of the push task in torch, differentiable in the states of object and pusher."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.errors import require
from pinwm_drake.spatial.rotations import quaternion_conjugate, quaternion_multiply
from pinwm_drake.tasks.push import LENGTH, SPEED, TURN, PushTask

_LEAST = 1e-16  # m^2 and rad^2: where a distance or an angle is 0, so is its gradient


@dataclass(frozen=True, eq=False)
class TorchProgress:
    """Progress of W worlds, as `tasks.Progress` has it, in tensors.

    Attributes:
        distance: (W,) m, from the object to the goal.
        angle: (W,) rad, between the object's orientation and the goal's.
        reach: (W,) m, from the pusher to the object's origin.
        success: (W,) bool.
    """

    distance: Tensor
    angle: Tensor
    reach: Tensor
    success: Tensor


class TorchPush:
    """Push task whose rewards and states have gradients.

    Success is a jump: its bonus has no gradient, and `rewards` can leave it out.

    Attributes:
        task: The task, with the shaped reward and one goal.
    """

    def __init__(self, task: PushTask) -> None:
        """Takes the constants of a task.

        Raises:
            ParameterError: The task draws goals, or has another reward.
        """
        require("reward", task.reward, task.reward == "shaped", "shaped")
        require("goal_range", task.goal_range, not task.goal_size, "none")
        self.task = task
        self._goal = torch.tensor(task.goal, dtype=torch.float64)
        self._q_GW = quaternion_conjugate(torch.from_numpy(task.q_WG))
        q_WO = np.array(task.q_WO) / np.linalg.norm(task.q_WO)
        self._q_OW = quaternion_conjugate(torch.from_numpy(q_WO))

    def measure(self, object_state: Tensor, p_WP: Tensor) -> TorchProgress:
        """Progress of W worlds.

        Args:
            object_state: (W, 13) q_WO wxyz, of unit norm, p_WO [m], ω_WO [rad/s], v_WO [m/s], world.
            p_WP: (W, 3) m, world.
        """
        task, p_WO = self.task, object_state[:, 4:6]
        distance = _length(p_WO - self._goal[:2])
        q_GO = quaternion_multiply(self._q_GW, object_state[:, :4])
        angle = 2.0 * torch.atan2(_length(q_GO[:, 1:]), q_GO[:, 0].abs())
        moving = object_state.detach()
        at_rest = (_length(moving[:, 10:13]) < task.rest_speed) & (_length(moving[:, 7:10]) < task.rest_turn)
        success = (distance.detach() < task.tolerance) & (angle.detach() < task.turn_tolerance) & at_rest
        return TorchProgress(distance, angle, _length(p_WP[:, :2] - p_WO), success)

    def rewards(self, before: TorchProgress, after: TorchProgress, *, bonus: bool = True) -> Tensor:
        """Shaped rewards (W,) of the actions between two progresses, with the bonus of success or without."""
        gain = _potential(before) - _potential(after) - self.task.cost
        return gain + self.task.bonus * after.success if bonus else gain

    def state(self, object_state: Tensor, p_WP: Tensor) -> Tensor:
        """State (W, 11) float32, as `PushTask.state` has it; arguments as for `measure`."""
        goal, p_WO = self._goal, object_state[:, 4:6]
        turned = quaternion_multiply(object_state[:, :4], self._q_OW.expand(len(object_state), 4))
        yaw = 2.0 * torch.atan2(turned[:, 3], turned[:, 0])
        turn = yaw - goal[2]
        parts = [
            _turned(p_WO - goal[:2], goal[2]) / LENGTH,
            torch.stack([turn.cos(), turn.sin()], 1),
            _turned(object_state[:, 10:12], goal[2]) / SPEED,
            object_state[:, 9:10] / TURN,
            _turned(p_WP[:, :2] - p_WO, yaw) / LENGTH,
            _turned(p_WP[:, :2] - goal[:2], goal[2]) / LENGTH,
        ]
        bound = self.task.state_bound
        return torch.cat(parts, 1).clamp(-bound, bound).float()


def _length(vectors: Tensor) -> Tensor:
    """Lengths (W,) of vectors (W, n), with a gradient at 0 too."""
    return (vectors.square().sum(1) + _LEAST).sqrt()


def _turned(vectors: Tensor, yaw: Tensor) -> Tensor:
    """Components of vectors (W, 2) in axes that are turned by a yaw [rad], () or (W,)."""
    c, s = yaw.cos(), yaw.sin()
    x, y = vectors.unbind(1)
    return torch.stack([c * x + s * y, c * y - s * x], 1)


def _potential(progress: TorchProgress) -> Tensor:
    """Potential (W,) of the shaped reward."""
    return 10.0 * progress.distance + progress.angle + 2.0 * (progress.reach - 0.1).clamp(min=0.0)
