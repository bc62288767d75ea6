"""Actor and critic, smooth in the state, as the gradient goes through both."""

from dataclasses import replace

import torch
from torch import Tensor, nn

from pinwm_drake.learning.actors import Seen, StateActor
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds

_WIDTH = 128  # as SAC's teachers have it


class GaussianActor(StateActor):
    """Network from the state to the means of actions, with ELU, and one standard deviation for each component.

    Attributes:
        log_std: (n,) logarithms of the standard deviations, before the tanh.
    """

    def __init__(self, spec: PolicySpec, log_std: float) -> None:
        """Builds layers of the specification's width."""
        super().__init__(spec.task, 1, nn.ELU, spec.width)
        self.log_std = nn.Parameter(torch.full((spec.action_size,), log_std))

    def means(self, seen: Seen) -> Tensor:
        """Means (B, n) of the actions before the tanh."""
        found: Tensor = self.head(self.latent(seen))
        return found

    def forward(self, state: Tensor) -> Tensor:
        """Actions (B, n) of the means, along the world's axes."""
        return self.heading.action(self.means(state).tanh(), state)


def make_critic(spec: PolicySpec) -> nn.Module:
    """An untrained network from the state (B, state_size) to a value (B, 1)."""
    width = spec.width
    return nn.Sequential(
        nn.Linear(spec.task.state_size, width), nn.ELU(), nn.Linear(width, width), nn.ELU(), nn.Linear(width, 1)
    )


def teacher_spec(training: TrainingWorlds) -> PolicySpec:
    """Specification of a teacher's policy in the worlds of a training, as SAC has it."""
    return replace(training.spec("state"), head="tanh", width=_WIDTH)
