# SPDX-License-Identifier: MIT
"""Schema of `*.scenario.yaml`: object, pusher, camera, task and engine of a scene. SI units and radians throughout."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar, get_args

from pydantic import AfterValidator, ConfigDict, Field, PlainValidator, TypeAdapter, ValidationError, model_validator

from pinwm_drake.capture.scene import PusherKind
from pinwm_drake.documents import LONGEST_TEXT, ROUND_CONE, Entry, read_yaml
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.models import OBJECT_NAMES, resolve
from pinwm_drake.tasks import DEFAULT_TASK
from pinwm_drake.tasks.registry import task_from_document
from pinwm_drake.validation import Refusal, first_problem, place

Engine = Literal["twin", "hydroelastic", "point"]
ENGINES = get_args(Engine)
MEMORY, LOCAL = "memq://", "udpm://239.255.76.67:7667?ttl=0"


def _quantity(low: float, high: float, unit: str = "1") -> Any:
    allowed = f"a number from {low:g} to {high:g}" + ("" if unit == "1" else f" [{unit}]")
    return Field(ge=low, le=high, strict=True, json_schema_extra={"allowed": allowed, "unit": unit})


def _count(low: int, high: int) -> Any:
    return Field(ge=low, le=high, strict=True, json_schema_extra={"allowed": f"a whole number from {low} to {high}"})


def _length(length: int) -> Any:
    allowed = f"{length} finite numbers"
    return Field(min_length=length, max_length=length, strict=True, json_schema_extra={"allowed": allowed})


def _list(*values: float) -> Any:
    return field(default_factory=lambda: list(values))


def _known(task: Any) -> Any:
    try:
        task_from_document(task)
    except ParameterError as error:
        raise ValueError(str(error)) from error
    return task


def _where(allowed: Callable[[Any], bool], words: str) -> AfterValidator:
    def check(value: Any) -> Any:
        if not allowed(value):
            raise ValueError(words)
        return value

    return AfterValidator(check)


_Text = Annotated[
    str,
    _where(lambda text: bool(text.strip()) and text.isprintable(), "text"),
    _where(lambda text: len(text) <= LONGEST_TEXT, f"text of at most {LONGEST_TEXT} characters"),
]
_Metres = Annotated[float, _quantity(-100.0, 100.0, "m")]
_Radians = Annotated[float, _quantity(-2 * math.pi, 2 * math.pi, "rad")]
_Share = Annotated[float, _quantity(-1.0, 1.0)]
_Friction = Annotated[float, _quantity(0.0, 2.0)]
_Pixels = Annotated[int, _count(8, 4096)]
_Number = TypeVar("_Number")
_Vector = Annotated[list[_Number], _length(3)]
_Range = Annotated[
    list[_Number], _length(2), _where(lambda ends: ends[0] <= ends[1], "[low, high] with low at most high")
]
_Quaternion = Annotated[
    list[_Share],
    _length(4),
    _where(lambda q: abs(sum(value**2 for value in q) - 1) <= 1e-3, "a quaternion wxyz of unit norm"),
]


class _Checked:
    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)


@dataclass
class Units(_Checked):
    """The units of the file: these and no others, written down so that nobody has to guess."""

    length: Literal["m"] = "m"
    mass: Literal["kg"] = "kg"
    time: Literal["s"] = "s"
    angle: Literal["rad"] = "rad"


@dataclass
class Theta(_Checked):
    """The physical parameters of an object of uniform density.

    Attributes:
        mass: kg, mass of the object.
        friction_floor: Coulomb coefficient of the pair object and floor.
        friction_pusher: Coulomb coefficient of the pair object and pusher.
        restitution: Coefficient of restitution of both pairs.
    """

    mass: Annotated[float, _quantity(1e-3, 100.0, "kg")] = 1.0
    friction_floor: _Friction = 0.03
    friction_pusher: _Friction = 0.03
    restitution: Annotated[float, _quantity(0.0, 0.9)] = 0.0


@dataclass
class Shape(_Checked):
    """The shape of a pusher, its axis along z; see `pinwm_drake.capture.scene.PusherShape`.

    Attributes:
        kind: sphere, capsule or cylinder.
        radius: m, of sphere, caps or cylinder.
        length: m, length of the straight part; 0 for a sphere.
    """

    kind: PusherKind = "sphere"
    radius: Annotated[float, _quantity(0.003, 0.05, "m")] = 0.01
    length: Annotated[float, _quantity(0.0, 0.5, "m")] = 0.0

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.kind == "sphere") != (self.length == 0):
            raise Refusal("a length of 0 for a sphere, and above 0 for a capsule or a cylinder", "length")
        return self


@dataclass
class Pusher(_Checked):
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
    max_speed: Annotated[float, _quantity(1e-3, 10.0, "m/s")] = 1.0
    low: _Vector[_Metres] = _list(-1.0, -1.0, -1.0)
    high: _Vector[_Metres] = _list(1.0, 1.0, 1.0)
    period: Annotated[float | None, _quantity(1e-5, 1.0, "s")] = None
    horizon: Annotated[float, _quantity(1e-3, 10.0, "s")] = 0.1

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not all(low < high for low, high in zip(self.low, self.high, strict=True)):
            raise Refusal(f"below `high`, {self.high}, along every axis", "low")
        return self


@dataclass
class Physics(_Checked):
    """Settings of the twin's physics; null for those of the twin folder, or 1/240 s and patch.

    Attributes:
        time_step: s, one step of the physics.
        support: Points that carry the object: the "corners" of its mesh, those of a "patch" of its face, or four of
            each of its "faces", with which it lands alike.
        facets: Whether the object touches as its mesh, also where that is nearly round; null for what the twin folder
            says, or false.
        steps_per_update: Number of steps of the physics in one update of the diagram's state.
    """

    time_step: Annotated[float | None, _quantity(1e-5, 0.1, "s")] = None
    support: Literal["corners", "patch", "faces"] | None = None
    facets: bool | None = None
    steps_per_update: Annotated[int, _count(1, 1000)] = 1


@dataclass
class Plant(_Checked):
    """Settings of Drake's plants.

    Attributes:
        time_step: s, one step; null for the longest one that divides the pusher's period and is at most 1/3840 s.
        reference_speed: m/s, speed of approach at which a restitution above 0 is meant: Drake's depends on it.
    """

    time_step: Annotated[float | None, _quantity(1e-6, 1e-2, "s")] = None
    reference_speed: Annotated[float, _quantity(1e-3, 10.0, "m/s")] = 0.12


@dataclass
class View(_Checked):
    """The camera of the `rgb` port, which stands still and has the world's z upwards.

    Attributes:
        width: px, width of an image.
        height: px, height of an image.
        fov_y: rad, angle of view over the whole height.
        p_WC: (3,) m, world: position of the camera.
        p_WT: (3,) m, world: point that it looks at.
    """

    width: _Pixels = 128
    height: _Pixels = 128
    fov_y: Annotated[float, _quantity(0.02, 2.8, "rad")] = 0.7
    p_WC: _Vector[_Metres] = _list(0.0, -0.45, 0.55)
    p_WT: _Vector[_Metres] = _list(0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.p_WC[:2] == self.p_WT[:2]:
            raise Refusal("a point that is not right above or below `p_WC`", "p_WT")
        return self


@dataclass
class Start(_Checked):
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

    x: _Range[_Metres] = _list(0.0, 0.0)
    y: _Range[_Metres] = _list(0.0, 0.0)
    yaw: _Range[_Radians] = _list(0.0, 0.0)
    q_WO: _Quaternion = _list(1.0, 0.0, 0.0, 0.0)
    rolls: Annotated[int, _count(1, 3600)] = 1
    roll_axis: Annotated[_Vector[_Share], _where(any, "an axis that is not zero")] = _list(0.0, 0.0, 1.0)
    pusher_angle: _Range[_Radians] = _list(-math.pi, math.pi)
    pusher_from: Literal["world", "object"] = "world"
    pusher_gap: _Range[Annotated[float, _quantity(0.0, 10.0, "m")]] = _list(0.005, 0.03)
    pusher_height: _Metres = 0.025


@dataclass
class LcmLink(_Checked):
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
        key_file: File with the key by which both ends sign what they send, see `Seal`; null where nobody signs.
    """

    url: _Text = MEMORY
    command_channel: _Text = "PINWM_PUSHER_COMMAND"
    state_channel: _Text = "PINWM_PUSHER_STATE"
    image_channel: _Text = "PINWM_IMAGES"
    period: Annotated[float, _quantity(1e-3, 0.1, "s")] = 0.005
    image_period: Annotated[float, _quantity(1e-3, 10.0, "s")] = 0.05
    timeout: Annotated[float, _quantity(1e-3, 10.0, "s")] = 0.1
    key_file: _Text | None = None


@dataclass
class Scenario(_Checked):
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
    name: _Text = DEFAULT_TASK
    object: Annotated[str, _where(OBJECT_NAMES.__contains__, ", ".join(OBJECT_NAMES))] | None = None
    twin: _Text | None = None
    engine: Engine = "twin"
    theta: Theta | None = None
    task: Annotated[dict[str, Any], PlainValidator(_known)] = field(default_factory=lambda: {"name": DEFAULT_TASK})
    pusher: Pusher = field(default_factory=Pusher)
    physics: Physics = field(default_factory=Physics)
    plant: Plant = field(default_factory=Plant)
    camera: View = field(default_factory=View)
    start: Start = field(default_factory=Start)
    gravity: Annotated[float | None, _quantity(1e-3, 1e3, "m/s^2")] = None
    lcm: LcmLink = field(default_factory=LcmLink)
    num_worlds: Annotated[int, _count(1, 65536)] = 1
    seed: Annotated[int, _count(0, 2**63 - 1)] = 0


_SCENARIO = TypeAdapter(Scenario)


def check_scenario(path: Path, document: Any) -> Scenario:
    """Scenario of a document.

    Args:
        path: File that messages name.
        document: The document, plain data.

    Raises:
        InputError: A key is unknown, or a value is of the wrong kind, in another unit or out of range; the message
            names file and key.
    """
    try:
        scenario = _SCENARIO.validate_python(document)
    except ValidationError as error:
        problem = first_problem(error, Scenario)
        if problem.kind == "extra_forbidden":
            owner = reduce(getitem, problem.location[:-1], document)
            Entry(path, place(problem.location[:-1]), owner).only(*problem.allowed.split(", "))
        entry = Entry(path, problem.place, problem.value)
        if problem.kind in ("float_type", "finite_number") and problem.place.endswith("]"):
            entry.number()
        raise entry.refusal(problem.allowed) from None
    if (scenario.object is None) == (scenario.twin is None):
        found = "neither" if scenario.twin is None else "both"
        raise InputError(path, value=found, allowed="either an object or a twin")
    if scenario.twin is not None and scenario.theta is not None:
        raise Entry(path, "theta", document["theta"]).refusal("null or nothing beside a twin, which has its own")
    return scenario


def load_scenario(path: Path | str) -> Scenario:
    """Read a scenario.

    Args:
        path: A YAML file, or a `package://pinwm_models/` URL of one.

    Returns:
        The scenario, checked; its twin's folder is relative to the working directory.

    Raises:
        InputError: The file cannot be read, a key is unknown, or a value is of the wrong kind, in another unit or
            out of range; the message names file and key.
    """
    file = resolve(str(path))
    entry = read_yaml(file)
    if isinstance(entry.value, dict) and (physics := entry.find("physics")) is not None:
        entry.value["physics"] = physics.without("friction_directions", ROUND_CONE).value
    scenario = check_scenario(file, entry.value)
    if scenario.twin is not None:
        folder = file.parent / scenario.twin
        if not folder.is_dir():
            raise InputError(file, value=f"twin = {scenario.twin}", allowed="the folder of a twin")
        scenario.twin = str(folder)
    return scenario
