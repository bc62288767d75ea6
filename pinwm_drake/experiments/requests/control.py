# SPDX-License-Identifier: MIT
"""Requests of commands that run a policy's bundle: export, control, arm and rehearse."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pinwm_drake.errors import require
from pinwm_drake.experiments.requests.twins import require_suffix
from pinwm_drake.request import ADVANCED, BUDGET, DATA, FLATTEN, LAB, argument, option, request

StationEngine = Literal["twin", "hydroelastic", "point", "lcm"]
Contact = Literal["hydroelastic", "point"]
SimulatedArm = Annotated[Literal["iiwa", "panda"], option("Arm that is simulated.", group=LAB)]
Latency = Annotated[float, option("Time from an image's exposure to its arrival.", group=LAB, unit="s", ge=0, le=1)]
Bundle = Annotated[
    str, argument("Folder that `pinwm export` wrote, or the name of a bundle that ships.", "BUNDLE", completes="bundle")
]
_SCENE = option(
    "Scenario that ships, a .scenario.yaml file, or the folder of a twin.",
    group=DATA,
    default="the bundle's",
    completes="scene",
)
Scene = Annotated[str | None, _SCENE]
GoalPose = Annotated[
    tuple[float, float, float] | None,
    option("Goal of the object, for a bundle that takes one.", metavar="X Y YAW", unit="m, m, rad"),
]
LcmUrl = Annotated[
    str | None,
    option("Address of LCM; udpm://ADDRESS:PORT?ttl=0 stays on this machine.", group=LAB, default="the scenario's"),
]
Key = Annotated[
    Path | None,
    option("Key file that signs messages, the same on both ends; see the threat model.", group=LAB, default="unsigned"),
]
Port = Annotated[int | None, option("Port of Meshcat.", group=LAB, ge=1024, le=65535, default="first free from 7000")]
Seed = Annotated[int, option("Seed of the start of object and pusher.", group=ADVANCED, ge=0, le=2**32 - 1)]
_Corner = tuple[float, float, float] | None


@request
class ExportRequest:
    """Request of a bundle: what `pinwm export` does."""

    policy: Annotated[
        Path, argument("Folder of a policy of images that `pinwm train` wrote.", "POLICY", completes="policy")
    ]
    bundle: Annotated[Path, argument("Folder of the bundle, new or empty.", "BUNDLE", result="beside")]
    scene: Annotated[
        str | None,
        option(
            "Scene of the golden samples: a scenario, or a twin's folder.",
            group=DATA,
            default="the policy's",
            completes="scene",
        ),
    ] = None
    max_speed: Annotated[
        float | None, option("Speed limit of the pusher.", group=LAB, gt=0, unit="m/s", default="as in training")
    ] = None
    max_acceleration: Annotated[
        float | None,
        option(
            "Acceleration limit of the pusher.", group=LAB, gt=0, unit="m/s^2", default="a turn-around within an action"
        ),
    ] = None
    max_image_age: Annotated[
        float | None,
        option("Age of an image at which the robot stops.", group=LAB, gt=0, unit="s", default="two actions"),
    ] = None
    box_low: Annotated[
        _Corner,
        option(
            "Lower corner of the pusher's box.",
            group=LAB,
            unit="m",
            metavar="X Y Z",
            default="that of training, 10 mm lower",
        ),
    ] = None
    box_high: Annotated[
        _Corner,
        option(
            "Upper corner of the pusher's box.",
            group=LAB,
            unit="m",
            metavar="X Y Z",
            default="that of training, 10 mm higher",
        ),
    ] = None
    arms: Annotated[bool, option("Check in simulation which arms follow the policy.", group=LAB)] = True
    seed: Annotated[int, option("Seed of the golden samples' episodes.", group=ADVANCED, ge=0)] = 0

    @property
    def limits(self) -> dict[str, Any]:
        """Safety limits that are given, by name."""
        names = ("max_speed", "max_acceleration", "max_image_age", "box_low", "box_high")
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}


@request
class ControlRequest:
    """Request of a controlled run: what `pinwm control` does."""

    bundle: Bundle
    arm: Annotated[bool, option("Move the pusher, or only show what the policy would do.", "--arm/--dry-run")] = False
    engine: Annotated[StationEngine, option("Simulation to control, or lcm for a robot.")] = "hydroelastic"
    simulate_arm: Annotated[bool, option("Simulate an arm behind LCM in this process; no robot is needed.")] = False
    arm_model: SimulatedArm = "iiwa"
    goal: GoalPose = None
    force: Annotated[bool, option("Allow another object or pusher than in training.")] = False
    scene: Scene = None
    duration: Annotated[
        float, option("Longest duration; the run ends earlier at the goal.", group=BUDGET, unit="s", ge=0.1, le=600)
    ] = 20.0
    contact: Annotated[Contact, option("Contact model of the simulated arm; point takes half the time.", group=LAB)] = (
        "hydroelastic"
    )
    latency: Latency = 0.0
    lcm_url: LcmUrl = None
    key: Key = None
    station: Annotated[
        Path | None,
        option("File station.yaml of the lab; a bundle for another station is refused.", group=LAB),
    ] = None
    record: Annotated[
        Path | None,
        option("HTML file of what Meshcat shows; it needs no server.", group=DATA, result="beside"),
    ] = None
    meshcat: Annotated[bool, option("Show the run in a browser on this machine, in real time.", group=LAB)] = False
    port: Port = None
    seed: Seed = 0

    def __post_init__(self) -> None:
        """Check options that exclude each other."""
        robot = self.engine == "lcm" and not self.simulate_arm
        require("--lcm-url", self.lcm_url, self.lcm_url is None or robot, "none, but for a robot behind lcm")
        require("--key", self.key, self.key is None or self.station_engine == "lcm", "none, but with lcm")
        simulated = self.simulate_arm or self.arm_model == "iiwa"
        require("--arm-model", self.arm_model, simulated, "iiwa, but with --simulate-arm")
        require("--latency", self.latency, self.simulate_arm or self.latency == 0, "0, but with --simulate-arm")
        require("--meshcat", self.meshcat, not (self.meshcat and robot), "none for a robot, which can be looked at")
        require("--record", self.record, not (self.record and robot), "none for a robot, which can be filmed")
        require_suffix("--record", self.record, ".html", ".htm")

    @property
    def station_engine(self) -> StationEngine:
        """Engine of the station: "lcm" for a simulated arm as well."""
        return "lcm" if self.simulate_arm else self.engine


@request
class ArmRequest:
    """Request of a simulated arm: what `pinwm arm` does."""

    bundle: Annotated[
        str, argument("Bundle that will control the arm; it sets the image size.", "BUNDLE", completes="bundle")
    ] = "push_t"
    scene: Scene = None
    image_size: Annotated[
        int | None,
        option(
            "Side of the images that the policy sees.", group=DATA, unit="px", ge=8, le=4096, default="the bundle's"
        ),
    ] = None
    duration: Annotated[float, option("Duration of the simulation.", group=BUDGET, unit="s", ge=0.1, le=3600)] = 60.0
    latency: Latency = 0.0
    arm_model: SimulatedArm = "iiwa"
    contact: Annotated[Contact, option("Contact model of the arm; point takes half the time.", group=LAB)] = "point"
    lcm_url: LcmUrl = None
    key: Key = None
    meshcat: Annotated[bool, option("Show the arm in a browser on this machine.", group=LAB)] = False
    port: Port = None
    seed: Seed = 0


@request
class RehearseRequest:
    """Request of a rehearsal.

    Raises:
        ParameterError: A value is out of range, or there is no such kind of fault.
    """

    bundle: Bundle
    scene: Scene = None
    goal: GoalPose = None
    faults: Annotated[bool, option("Inject faults at random moments.")] = False
    moments: Annotated[
        int, option("Number of random moments for each kind of fault.", group=BUDGET, ge=0, le=10_000)
    ] = 5
    kinds: Annotated[tuple[str, ...], option("Kind of fault; repeat it.", "--kind", default="all")] = ()
    minutes: Annotated[float, option("Least duration of normal work.", group=BUDGET, unit="min", ge=0, le=1440)] = 0.0
    episodes: Annotated[
        int | None,
        option(
            "Least number of episodes of normal work.", group=BUDGET, ge=0, le=100_000, default="10, or 0 with faults"
        ),
    ] = None
    latency: Latency = 0.0
    arm_model: SimulatedArm = "iiwa"
    port: Annotated[
        int, option("Port of LCM on this machine; two rehearsals at once need two.", group=LAB, ge=1024, le=65535)
    ] = 7690
    seed: Annotated[int, option("Seed of moments and starts.", group=ADVANCED, ge=0, le=2**32 - 1)] = 0

    def __post_init__(self) -> None:
        """Check the kinds of faults; resolves the number of episodes."""
        if self.kinds:
            from pinwm_drake.experiments.rehearsal.faults import KINDS

            known = [kind.name for kind in KINDS]
            for name in self.kinds:
                require("--kind", name, name in known, ", ".join(known))
        if self.episodes is None:
            object.__setattr__(self, "episodes", 0 if self.faults or self.minutes else 10)

    @property
    def normal_episodes(self) -> int:
        """Least number of episodes of normal work."""
        return self.episodes or 0


@request
class RehearseRun:
    """Request of a rehearsal and its folder: what `pinwm rehearse` does."""

    rehearsal: Annotated[RehearseRequest, FLATTEN]
    out: Annotated[Path, option("Folder of the results, new or empty.", "--out", "-o", result="inside")] = Path(
        "out/rehearsal"
    )
    resume: Annotated[bool, option("Continue an interrupted rehearsal.", group=BUDGET)] = False
