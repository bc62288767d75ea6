"""The systems that the tables compare, each by what its policy is trained in."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from pinwm_drake.cousins.domain import CousinDomains, DomainSource
from pinwm_drake.cousins.randomization import RandomDomains
from pinwm_drake.paper.reproduce.scenes import TaskScene

SCENE, MPC, RANDOM_ACTIONS = "scene", "mpc", "random-actions"
Domains = Callable[[TaskScene, int], DomainSource]


@dataclass(frozen=True)
class System:
    """A system of the comparison.

    All systems that learn have the same trainer, networks, reward and budget; they differ in the domains of their
    episodes, and in whether their policies see past states and actions, by which to find out the domain.

    Attributes:
        name: Name of the system.
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
_ALL = (
    System("random", "one theta and colours, drawn once from R", PIN_WM, _random(once=True, painted=True)),
    System("robogsim", "the theta of `random`, fitted surfels", PIN_WM, _random(once=True)),
    System("domain-rand", f"theta from R for each episode; {_PAST}", PIN_WM, _random(), _HISTORY),
    System("domain-rand-2", f"theta from half of R, around the true; {_PAST}", PIN_WM, _random(share=0.5), _HISTORY),
    System("domain-rand-4", f"theta from a quarter of R, likewise; {_PAST}", PIN_WM, _random(share=0.25), _HISTORY),
    System(ASID, "theta by cross-entropy, 200 simulations", ASID, _cousins(0.0)),
    System(ASID_GENEROUS, "theta by cross-entropy, 4,000 simulations", ASID_GENEROUS, _cousins(0.0)),
    System(PLANAR, "theta by a planar simulator", PLANAR, _cousins(0.0)),
    System(NO_COUSINS, "the twin of one push", PIN_WM, _cousins(0.0)),
    System(PIN_WM, "cousins of the twin of one push", PIN_WM, _cousins(0.1)),
    System(DREAMER, "no world: imagines what a model of 100 episodes of random pushes says", SCENE, None),
    System(DIFFUSION, "no world: imitates 100 episodes of an expert in the plant", SCENE, None),
    System(TRUE_THETA, "the true theta", SCENE, _cousins(0.0)),
    System(MPC, "not trained: plans in the twin, sees the state", PIN_WM, None),
    System(RANDOM_ACTIONS, "not trained: random actions", SCENE, None),
)
SYSTEMS: Mapping[str, System] = {system.name: system for system in _ALL}
