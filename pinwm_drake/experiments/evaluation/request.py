"""What an evaluation is asked for."""

import math
from dataclasses import dataclass

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.scenario.schema import ENGINES

MPC, RANDOM = "mpc", "random"
_LARGEST = 2**31  # of a seed


@dataclass(frozen=True)
class EvaluateRequest:
    """The options of `pinwm evaluate`, named and in units as there; those on which results depend.

    Raises:
        ParameterError: One is out of range.
    """

    policy: str
    scene: str = "push_t"
    engine: str = "hydroelastic"
    episodes: int = 100
    seed: int = 0
    tolerance: float | None = None
    turn_tolerance: float | None = None
    yaw: float | None = None
    max_steps: int | None = None
    max_translation: float | None = None
    model: str | None = None

    def __post_init__(self) -> None:
        """Checks what nothing else does."""
        if self.engine not in ENGINES:
            raise ParameterError(f"--engine: got {self.engine!r}; allowed: {', '.join(ENGINES)}")
        if self.episodes < 1:
            raise ParameterError(f"--episodes: got {self.episodes}; allowed: 1 or more")
        if not 0 <= self.seed <= _LARGEST - self.episodes:
            raise ParameterError(f"--seed: got {self.seed}; allowed: 0 to {_LARGEST - self.episodes}")
        if self.yaw is not None and not 0.0 <= self.yaw <= math.pi + 1e-9:
            raise ParameterError(f"--yaw: got {self.yaw}; allowed: 0 to pi")
        if self.max_translation is not None and self.policy not in (MPC, RANDOM):
            raise ParameterError(
                "--max-translation: got one beside a policy, which has its own; allowed: with mpc, random"
            )
        if self.model is not None and self.policy != MPC:
            raise ParameterError("--model: got one; allowed: with mpc")

    @property
    def seeds(self) -> range:
        """One for each episode."""
        return range(self.seed, self.seed + self.episodes)
