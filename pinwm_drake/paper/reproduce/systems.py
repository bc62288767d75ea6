# SPDX-License-Identifier: MIT
"""The paper's tasks as scenes, and the systems that the tables compare, each by what its policy is trained in."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from pinwm_drake.cousins.domain import CousinDomains, DomainSource
from pinwm_drake.cousins.randomization import FLIP_SPANS, RandomDomains, Spans
from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.systems.runs.capture_options import SimulateOptions
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.tasks.registry import recipe_of


@dataclass(frozen=True)
class TaskScene:
    """Task with its scene, its object and the ranges of ignorance.

    Attributes:
        scene: Scenario in which policies are trained and tried.
        capture_seed: Seed of the capture of the experiment's first seed.
    """

    name: str
    task: str
    scene: str
    object_name: str
    friction: float
    pusher_friction: float
    capture_seed: int
    episode: str
    spans: Spans

    @cached_property
    def true_theta(self) -> dict[str, float]:
        """True values of `THETA`'s parameters, SI units."""
        return {name: estimate.value for name, estimate in load_setup(self.scene).twin.theta.items()}

    @property
    def max_translation(self) -> float | None:
        """Longest translation of an action that policies are trained for, m; None for that of the pusher's speed."""
        return recipe_of(self.task).max_translation

    def capture(self, seed: int, *, quick: bool) -> SimulateOptions:
        """Options of the capture; a quick one has fewer and smaller images."""
        small: dict[str, Any] = (
            {"size": 128, "static_views": 6, "frames": 12, "rate": 12.0, "supersampling": 1} if quick else {}
        )
        return SimulateOptions(
            object_name=self.object_name,
            friction=self.friction,
            pusher_friction=self.pusher_friction,
            seed=self.capture_seed + seed,
            task=self.task,
            **small,
        )


_ALL = (
    TaskScene("push", "push", "push_t", "t_block", 0.03, 0.03, 0, "0000", Spans()),
    TaskScene("flip", "flip", "flip_mug", "mug", 0.2, 0.9, 1, "0001", FLIP_SPANS),
    TaskScene("push-cube", "push", "push_cube_slippery", "cube", 0.03, 0.03, 0, "0000", Spans()),
    TaskScene("push-large-t", "push", "push_large_t", "large_t", 0.03, 0.03, 0, "0000", Spans()),
    TaskScene("flip-cube", "flip", "flip_cube", "cube", 0.2, 0.9, 2, "0000", FLIP_SPANS),
)
TASK_SCENES: Mapping[str, TaskScene] = {scene.name: scene for scene in _ALL}
TASKS = ("push", "flip")  # those of most tables


def task_scene(task: str) -> TaskScene:
    """Scene of a name.

    Raises:
        ParameterError: There is no such scene.
    """
    if task not in TASK_SCENES:
        raise ParameterError(f"--task: got {task!r}; allowed: {', '.join(TASK_SCENES)}")
    return TASK_SCENES[task]


@dataclass(frozen=True)
class SceneCell(Cell):
    """Cell of what is made in a task's scene.

    Attributes:
        stand_in: Flag: in the stand-in for a robot; see `StandIn`.
    """

    task: str
    seed: int
    stand_in: bool = field(default=False, kw_only=True)

    @property
    def scene(self) -> TaskScene:
        """Scene of the task."""
        return task_scene(self.task)

    @property
    def place(self) -> str:
        """Folder of what is made for the same scene."""
        return f"{self.task}-stand-in" if self.stand_in else self.task


SCENE, MPC, RANDOM_ACTIONS = "scene", "mpc", "random-actions"
Domains = Callable[[TaskScene, int], DomainSource]


@dataclass(frozen=True)
class System:
    """A system of the comparison.

    All systems that learn have the same trainer, networks, reward and budget; they differ in the domains of their
    episodes, and in whether their policies see past states and actions, by which to find out the domain.

    Attributes:
        words: Description of what it is trained in, for tables.
        twin: Identification whose twin it is trained in; `SCENE` for the scene's own true parameters.
        domains: Distribution of the domains by task and seed; None for what is not trained in any.
        history: Number of past states and actions that its policy sees.
    """

    name: str
    words: str
    twin: str
    domains: Domains | None
    history: int = 0


def _random(**settings: object) -> Domains:
    """Domains from a task's ranges R, around its true theta where only a share of them is drawn from."""

    def domains(scene: TaskScene, seed: int) -> DomainSource:
        middle = None if settings.get("share", 1.0) == 1.0 else scene.true_theta
        return RandomDomains(scene.spans, middle=middle, seed=seed, **settings)  # type: ignore[arg-type]

    return domains


def _cousins(delta: float) -> Domains:
    return lambda scene, seed: CousinDomains(delta, False, seed)


ASID, ASID_GENEROUS, PLANAR = "asid", "asid-generous", "2d-physics"
PIN_WM, NO_COUSINS, TRUE_THETA, DIFFUSION = "pin-wm", "pin-wm-0", "true-theta", "diffusion-policy"
DREAMER = "dreamer-v2"
_HISTORY = 4  # of Domain Rand in Li et al., "PIN-WM" (RSS 2025)
_PAST = f"sees {_HISTORY} past states and actions"
_SYSTEMS = (
    System("random", "one theta and colours, drawn once from R", PIN_WM, _random(once=True, painted=True)),
    System("robogsim", "the theta of `random`, fitted surfels", PIN_WM, _random(once=True)),
    System("domain-rand", f"theta from R for each episode; {_PAST}", PIN_WM, _random(), _HISTORY),
    System("domain-rand-2", f"theta from half of R, around the true; {_PAST}", PIN_WM, _random(share=0.5), _HISTORY),
    System(
        "domain-rand-4", f"theta from a quarter of R, around the true; {_PAST}", PIN_WM, _random(share=0.25), _HISTORY
    ),
    System(ASID, "theta by cross-entropy, 200 simulations", ASID, _cousins(0.0)),
    System(ASID_GENEROUS, "theta by cross-entropy, 4,000 simulations", ASID_GENEROUS, _cousins(0.0)),
    System(PLANAR, "theta by a planar simulator", PLANAR, _cousins(0.0)),
    System(NO_COUSINS, "the twin of one push", PIN_WM, _cousins(0.0)),
    System(PIN_WM, "cousins of the twin of one push", PIN_WM, _cousins(0.1)),
    System(DREAMER, "a world model of 100 episodes of random pushes in the plant", SCENE, None),
    System(DIFFUSION, "100 demonstrations of an expert in the plant", SCENE, None),
    System(TRUE_THETA, "the true theta", SCENE, _cousins(0.0)),
    System(MPC, "not trained: plans in the twin, sees the state", PIN_WM, None),
    System(RANDOM_ACTIONS, "not trained: random actions", SCENE, None),
)
SYSTEMS: Mapping[str, System] = {system.name: system for system in _SYSTEMS}
