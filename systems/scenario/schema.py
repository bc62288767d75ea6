"""Schema of `*.scenario.yaml`: object, pusher, camera, task and engine of a scene. SI units and radians throughout."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from pydrake.common.yaml import yaml_load_typed

from pinwm_drake.capture.scene import PUSHER_KINDS
from pinwm_drake.documents import read_yaml
from pinwm_drake.errors import InputError
from pinwm_drake.models import OBJECT_NAMES
from pinwm_drake.systems.scenario.check import check_scenario
from pinwm_drake.tasks import DEFAULT_TASK

ENGINES = ("twin", "hydroelastic", "point")
MEMORY, LOCAL = "memq://", "udpm://239.255.76.67:7667?ttl=0"


def _quantity(default: object, low: float, high: float, unit: str) -> Any:
    """Field of a number, or of a list of numbers, with bounds and unit for `check_scenario`."""
    metadata = {"low": low, "high": high, "unit": unit}
    if isinstance(default, list):
        return field(default_factory=lambda: list(default), metadata={**metadata, "length": len(default)})
    return field(default=default, metadata=metadata)


def _choice(default: object, allowed: tuple[str, ...]) -> Any:
    return field(default=default, metadata={"allowed": allowed})


def _seconds(default: float, low: float, high: float) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "unit": "s"})


@dataclass
class Units:
    """The units of the file: these and no others, written down so that nobody has to guess.

    Attributes:
        length: m.
        mass: kg.
        time: s.
        angle: rad.
    """

    length: str = _choice("m", ("m",))
    mass: str = _choice("kg", ("kg",))
    time: str = _choice("s", ("s",))
    angle: str = _choice("rad", ("rad",))


@dataclass
class Theta:
    """The physical parameters of an object of uniform density.

    Attributes:
        mass: kg, mass of the object.
        friction_floor: Coulomb coefficient of the pair object and floor.
        friction_pusher: Coulomb coefficient of the pair object and pusher.
        restitution: Coefficient of restitution of both pairs.
    """

    mass: float = _quantity(1.0, 1e-3, 100.0, "kg")
    friction_floor: float = _quantity(0.03, 0.0, 2.0, "1")
    friction_pusher: float = _quantity(0.03, 0.0, 2.0, "1")
    restitution: float = _quantity(0.0, 0.0, 0.9, "1")


@dataclass
class Shape:
    """The shape of a pusher, its axis along z; see `pinwm_drake.capture.scene.PusherShape`.

    Attributes:
        kind: sphere, capsule or cylinder.
        radius: m, of sphere, caps or cylinder.
        length: m, length of the straight part; 0 for a sphere.
    """

    kind: str = _choice("sphere", PUSHER_KINDS)
    radius: float = _quantity(0.01, 0.003, 0.05, "m")
    length: float = _quantity(0.0, 0.0, 0.5, "m")


@dataclass
class Pusher:
    """The pusher and the limits of its motion.

    Attributes:
        shape: Shape of the pusher; null for that of the twin, or a sphere of 10 mm.
        max_speed: m/s, largest speed; a faster command is slowed down.
        low: (3,) m, world: lower corner of the box that its middle stays in.
        high: (3,) m, world: upper corner.
        period: s, period at which its velocity is sampled and held; null for the period of the twin's updates.
        horizon: s, duration of a commanded translation, and of an action.
    """

    shape: Shape | None = None
    max_speed: float = _quantity(1.0, 1e-3, 10.0, "m/s")
    low: list[float] = _quantity([-1.0, -1.0, -1.0], -100.0, 100.0, "m")
    high: list[float] = _quantity([1.0, 1.0, 1.0], -100.0, 100.0, "m")
    period: float | None = _quantity(None, 1e-5, 1.0, "s")
    horizon: float = _quantity(0.1, 1e-3, 10.0, "s")


@dataclass
class Physics:
    """Settings of the twin's physics; null for those of the twin folder, or 1/240 s, 32 and patch.

    Attributes:
        time_step: s, one step of the physics.
        friction_directions: Has no effect, as the friction cone is round; kept for older calls and files.
        support: Points that carry the object: the "corners" of its mesh, or a "patch" of its face.
        steps_per_update: Number of steps of the physics in one update of the diagram's state.
    """

    time_step: float | None = _quantity(None, 1e-5, 0.1, "s")
    friction_directions: int | None = _quantity(None, 4, 64, "1")
    support: str | None = _choice(None, ("corners", "patch"))
    steps_per_update: int = _quantity(1, 1, 1000, "1")


@dataclass
class Plant:
    """Settings of Drake's plants.

    Attributes:
        time_step: s, one step; null for the longest one that divides the pusher's period and is at most 1/3840 s.
        reference_speed: m/s, speed of approach at which a restitution above 0 is meant: Drake's depends on it.
    """

    time_step: float | None = _quantity(None, 1e-6, 1e-2, "s")
    reference_speed: float = _quantity(0.12, 1e-3, 10.0, "m/s")


@dataclass
class View:
    """The camera of the `rgb` port, which stands still and has the world's z upwards.

    Attributes:
        width: px, width of an image.
        height: px, height of an image.
        fov_y: rad, angle of view over the whole height.
        p_WC: (3,) m, world: position of the camera.
        p_WT: (3,) m, world: point that it looks at.
    """

    width: int = _quantity(128, 8, 4096, "px")
    height: int = _quantity(128, 8, 4096, "px")
    fov_y: float = _quantity(0.7, 0.02, 2.8, "rad")
    p_WC: list[float] = _quantity([0.0, -0.45, 0.55], -100.0, 100.0, "m")
    p_WT: list[float] = _quantity([0.0, 0.0, 0.0], -100.0, 100.0, "m")


@dataclass
class Start:
    """Places of object and pusher at the start; each range [low, high] is drawn from evenly.

    Attributes:
        x: [low, high] m, world: x of the object's origin O.
        y: [low, high] m, world: y of O.
        yaw: [low, high] rad, turn of the object about the world's z, after `q_WO`.
        q_WO: (4,) wxyz, orientation of the object before it is turned by `yaw`. It rests on the floor.
        rolls: Number of equal turns about `roll_axis` that make a whole one, of which any is drawn and made before
            `q_WO`; 1 for none. An object with facets rests on each of them.
        roll_axis: (3,) frame O: axis of these turns.
        pusher_angle: [low, high] rad, direction of the pusher, seen from the object; 0 is the x of `pusher_from`.
        pusher_from: What directions of the pusher are counted from: the "world", or the "object", turned by its yaw.
        pusher_gap: [low, high] m, between the pusher and the circle around the object.
        pusher_height: m, world: z of the pusher's middle.
    """

    x: list[float] = _quantity([0.0, 0.0], -100.0, 100.0, "m")
    y: list[float] = _quantity([0.0, 0.0], -100.0, 100.0, "m")
    yaw: list[float] = _quantity([0.0, 0.0], -2 * math.pi, 2 * math.pi, "rad")
    q_WO: list[float] = _quantity([1.0, 0.0, 0.0, 0.0], -1.0, 1.0, "1")
    rolls: int = _quantity(1, 1, 3600, "1")
    roll_axis: list[float] = _quantity([0.0, 0.0, 1.0], -1.0, 1.0, "1")
    pusher_angle: list[float] = _quantity([-math.pi, math.pi], -2 * math.pi, 2 * math.pi, "rad")
    pusher_from: str = _choice("world", ("world", "object"))
    pusher_gap: list[float] = _quantity([0.005, 0.03], 0.0, 10.0, "m")
    pusher_height: float = _quantity(0.025, -100.0, 100.0, "m")


@dataclass
class LcmLink:
    """The messages between a station with `engine="lcm"` and the driver of a robot.

        station ── command_channel ─► driver    lcmt_drake_signal (6), every `period`: v_WP [m/s], session, sequence,
                                                expiry [s, driver's clock]
        station ◄─ state_channel ──── driver    lcmt_drake_signal (10), every `period`: p_WP [m], v_WP [m/s], session,
                                                sequence, mode, fault
        station ◄─ image_channel ──── driver    lcmt_image_array of one RGBA image, every `image_period`

    World frame throughout; stamps in microseconds, of the sender's clock, which is one for states and images. The image
    is sRGB, its alpha 255 where the object is seen; whoever sends it has cut the object out. What has alpha 0 is white.

    A session is a random whole number up to 2^48 that a controller draws when a person arms it, and 0 while it may not
    move. The sequence counts periods of the station's clock. A command expires `timeout` after the last state that the
    station has heard. The driver's state echoes session and sequence of the last command that it took; its mode is 0
    while it waits for a session, 1 in one, and 2 when a fault, whose number is in `DRIVER_FAULTS`, latched it. See
    `CommandGate` for what it takes and what latches it, and `Hearing` for clocks. At the end of a run zero of no
    session is sent, and again two periods later: a driver that listens through Drake's LCM hears the first, not the
    last, of the messages that came since it looked.

    Attributes:
        url: Address of LCM; `MEMORY` within a process, `LOCAL` between processes of this machine.
        command_channel: Channel of commands to the robot.
        state_channel: Channel of the robot's states.
        image_channel: Channel of its camera's images.
        period: s, between commands, and between states.
        image_period: s, between images.
        timeout: s. Commands that stop for longer stop the robot, and their session is over; a state that is older
            counts as unknown.
    """

    url: str = MEMORY
    command_channel: str = "PINWM_PUSHER_COMMAND"
    state_channel: str = "PINWM_PUSHER_STATE"
    image_channel: str = "PINWM_IMAGES"
    period: float = _seconds(0.005, 1e-3, 0.1)
    image_period: float = _seconds(0.05, 1e-3, 10.0)
    timeout: float = _seconds(0.1, 1e-3, 10.0)


@dataclass
class Scenario:
    """A scene: an object that a pusher moves on a floor in front of a camera, and a task.

    Attributes:
        units: Units of the file.
        name: Name of the scene.
        object: Name of an object that ships with pinwm_drake; null with a twin.
        twin: A twin's folder, relative to the file; null with an object.
        engine: Engine that moves it: the "twin", or Drake's plant with "hydroelastic" or "point" contact.
        theta: The physical parameters of an object; null for the default ones, or with a twin for its own.
        task: The name of a task, and those of its fields that differ from its class's defaults.
        pusher: The pusher and its limits.
        physics: Settings of the twin's physics.
        plant: Settings of Drake's plants.
        camera: Camera of the `rgb` port.
        start: Places of object and pusher at the start.
        gravity: m/s^2, downwards; null for that of the twin, or 9.81.
        lcm: Messages to and from a robot, for a station with the engine "lcm".
        num_worlds: Number of worlds that the twin engine holds.
        seed: Seed of the start, and of everything else that is drawn.

    `load_scenario` checks one from a file, `make_setup` one that was made in Python, and both raise InputError where
    something is out of range.
    """

    units: Units = field(default_factory=Units)
    name: str = DEFAULT_TASK
    object: str | None = _choice(None, OBJECT_NAMES)
    twin: str | None = None
    engine: str = _choice("twin", ENGINES)
    theta: Theta | None = None
    task: dict[str, Any] = field(default_factory=lambda: {"name": DEFAULT_TASK})
    pusher: Pusher = field(default_factory=Pusher)
    physics: Physics = field(default_factory=Physics)
    plant: Plant = field(default_factory=Plant)
    camera: View = field(default_factory=View)
    start: Start = field(default_factory=Start)
    gravity: float | None = _quantity(None, 1e-3, 1e3, "m/s^2")
    lcm: LcmLink = field(default_factory=LcmLink)
    num_worlds: int = _quantity(1, 1, 65536, "1")
    seed: int = _quantity(0, 0, 2**63 - 1, "1")


def load_scenario(path: Path | str) -> Scenario:
    """Reads a scenario.

    Args:
        path: A YAML file, or a `package://pinwm_models/` URL of one.

    Returns:
        The scenario, checked; its twin's folder is relative to the working directory.

    Raises:
        InputError: The file cannot be read, a key is unknown, or a value is of the wrong kind, in another unit or
            out of range; the message names file and key.
    """
    from pinwm_drake.models import resolve

    file = resolve(str(path))
    entry = read_yaml(file)
    check_scenario(entry, Scenario)
    # Numbers such as 1e-3, which YAML 1.1 takes for text, have become numbers in `read_yaml`. A task's own class has
    # checked its entry, whose keys Drake's loader cannot know.
    task = entry.value.pop("task", None)
    scenario: Scenario = yaml_load_typed(schema=Scenario, data=yaml.safe_dump(entry.value))
    if task is not None:
        scenario.task = task
    if scenario.twin is not None:
        folder = file.parent / scenario.twin
        if not folder.is_dir():
            raise InputError(file, value=f"twin = {scenario.twin}", allowed="the folder of a twin")
        scenario.twin = str(folder)
    return scenario
