"""The request of an evaluation."""

import math
from dataclasses import dataclass

from pinwm_drake.errors import require
from pinwm_drake.systems.runs.realism.stand_in import StandIn
from pinwm_drake.systems.scenario.schema import ENGINES

MPC, RANDOM = "mpc", "random"
_LARGEST = 2**31  # one more than the largest seed of an episode


@dataclass(frozen=True)
class EvaluateRequest:
    """Request of an evaluation: the options of `pinwm evaluate` on which results depend, named and in units as there.

    Raises:
        ParameterError: An option is out of range.
    """

    policy: str
    scene: str = "push_t"
    engine: str = "hydroelastic"
    episodes: int = 100
    seed: int = 0
    tolerance: float | None = None
    turn_tolerance: float | None = None
    yaw: float | None = None
    latency: float = 0.0
    max_steps: int | None = None
    max_translation: float | None = None
    model: str | None = None
    task: str | None = None
    stand_in: bool = False

    def __post_init__(self) -> None:
        require("--engine", repr(self.engine), self.engine in ENGINES, ", ".join(ENGINES))
        require("--episodes", self.episodes, self.episodes >= 1, "1 or more")
        last = _LARGEST - self.episodes
        require("--seed", self.seed, 0 <= self.seed <= last, f"0 to {last}")
        require("--yaw", self.yaw, self.yaw is None or 0.0 <= self.yaw <= math.pi + 1e-9, "0 to pi")
        require("--latency", self.latency, 0.0 <= self.latency < math.inf, "0 or more")
        plant = not self.stand_in or self.engine != "twin"
        require("--stand-in", f"one with engine {self.engine}", plant, "with hydroelastic, point")
        own = not self.stand_in or self.latency == 0.0
        require("--latency", "one beside that of the stand-in", own, "without --stand-in")
        free = self.max_translation is None or self.policy in (MPC, RANDOM)
        require("--max-translation", "one beside a policy, which has its own", free, "with mpc, random")
        named = self.task is None or self.policy in (MPC, RANDOM)
        require("--task", "one beside a policy, which has its own", named, "with mpc, random")
        require("--model", "one", self.model is None or self.policy == MPC, "with mpc")

    @property
    def station(self) -> StandIn | None:
        """Stand-in for a robot in which the episodes run; None for the scene as it is believed to be."""
        return StandIn() if self.stand_in else None

    @property
    def delay(self) -> float:
        """Time after which actions take effect, s: the stand-in's own where there is one."""
        return self.latency if self.station is None else self.station.latency

    @property
    def seeds(self) -> range:
        """Seeds of the episodes, one for each."""
        return range(self.seed, self.seed + self.episodes)
