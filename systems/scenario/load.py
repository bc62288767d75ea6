"""The scenarios that ship with pinwm_drake, by their names."""

import dataclasses
import hashlib
import json
import math
from pathlib import Path
from typing import Any, TypeAlias

from pinwm_drake.capture.scene import read_capture
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.models import PACKAGE_NAME, model_names
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.systems.sampling import whole_multiple
from pinwm_drake.systems.scenario.schema import LOCAL, MEMORY, Scenario, Start, load_scenario
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.scenario.start import level_height
from pinwm_drake.twin import Twin, read_twin
from pinwm_drake.twin.origin import Origin

_FOLDER, _SUFFIX = "scenarios/", ".scenario.yaml"
_AROUND = [-0.02, 0.02]  # m, of the origin
_ANY_YAW = [-math.pi, math.pi]
Scene: TypeAlias = Scenario | Setup | str | Path
_USUAL = "push_t"
_ROUNDING = 1e-9  # by which it may exceed what is allowed, relative


def shipped_scenarios() -> list[str]:
    """Their names, such as "push_t", sorted."""
    names = (name for name in model_names() if name.startswith(_FOLDER) and name.endswith(_SUFFIX))
    return [name.removeprefix(_FOLDER).removesuffix(_SUFFIX) for name in names]


def scenario_path(text: str) -> str:
    """What `load_scenario` takes for a scenario that a user names.

    Args:
        text: A scenario's file, the name of one that ships, or a `package://` URL.

    Raises:
        InputError: There is no such file, and none of that name.
    """
    if text in shipped_scenarios() and not Path(text).exists():
        return f"package://{PACKAGE_NAME}/{_FOLDER}{text}{_SUFFIX}"
    if "://" not in text and not Path(text).exists():
        raise InputError(text, allowed=f"a file, a twin's folder, or one of {', '.join(shipped_scenarios())}")
    return text


def read_setup(path: str) -> Setup:
    """Reads what is to be cross-checked.

    Args:
        path: The folder of a twin, or a scenario: a file, or a `package://pinwm_models/` URL of one.

    Returns:
        The setup. Of a twin's folder: the object lies as in the capture that it was identified from, or as its mesh
        does where that is gone, at a random yaw.

    Raises:
        InputError: There is nothing of that kind, or a file of it cannot be used.
        ParameterError: Periods and time steps of the scenario do not divide each other.
    """
    folder = Path(path)
    if folder.is_dir():
        twin = read_twin(folder)
        start = Start(x=_AROUND, y=_AROUND, yaw=_ANY_YAW, q_WO=_lies(twin))
        return make_setup(Scenario(name=twin.name, twin=path, start=start))
    if not path.startswith("package://") and not folder.is_file():
        raise InputError(path, value="nothing", allowed="the folder of a twin, or a .scenario.yaml file")
    return make_setup(load_scenario(path))


def _lies(twin: Twin) -> list[float]:
    """q_WO wxyz of the capture that a twin is from."""
    origin = Origin.read(twin)
    if origin is not None:
        try:
            return [float(value) for value in read_capture(origin.path).object.X_WO.q]
        except InputError:  # moved, or changed
            pass
    return [1.0, 0.0, 0.0, 0.0]


def environment_setup(
    scene: Scene,
    *,
    num_worlds: int = 1,
    time_step: float | None = None,
    friction_directions: int | None = None,
    image_size: int | None = None,
) -> Setup:
    """Loads a scene for an environment.

    The velocity of the pusher is constant in an action, so that state and sample are taken once an action, whatever
    the scenario says: the steps of the physics are the same, and the diagram is run less often.

    Args:
        scene: A scenario, a setup, the name of a scenario that ships, the path of one, or the folder of a twin: the
            scene of push_t with the twin's object and pusher.
        num_worlds: 1 or more.
        time_step: s, of the twin's physics; None for that of the scene. It divides the horizon of an action.
        friction_directions: Of the twin's physics; None for those of the scene.
        image_size: px, both width and height; None for the camera's.

    Raises:
        InputError: A file cannot be used, or there is none of that name.
        ParameterError: The horizon is no whole multiple of the time step.
    """
    setup = scene if isinstance(scene, Setup) else make_setup(_scenario(scene))
    scenario, twin, camera = setup.scenario, setup.twin, setup.camera
    settings: dict[str, Any] = {"time_step": time_step, "friction_directions": friction_directions}
    given = {name: value for name, value in settings.items() if value is not None}
    twin = dataclasses.replace(twin, **given)
    view = scenario.camera
    if image_size is not None:
        view = dataclasses.replace(view, width=image_size, height=image_size)
        camera = Camera.from_field_of_view(image_size, image_size, view.fov_y)
    steps = whole_multiple("pusher.horizon", scenario.pusher.horizon, twin.time_step, "the time step")
    physics = dataclasses.replace(scenario.physics, steps_per_update=steps, **given)
    pusher = dataclasses.replace(scenario.pusher, period=None)
    scenario = dataclasses.replace(scenario, num_worlds=num_worlds, physics=physics, pusher=pusher, camera=view)
    period = twin.time_step * steps
    whole_multiple("pusher.horizon", period, setup.plant_time_step, "plant.time_step")
    return dataclasses.replace(setup, scenario=scenario, twin=twin, camera=camera, period=period)


def with_start_yaw(setup: Setup, yaw: float, goal_yaw: float = 0.0) -> Setup:
    """A scene whose object is turned at the start by `yaw` [rad] from the goal at most, either way."""
    start = dataclasses.replace(setup.scenario.start, yaw=[goal_yaw - yaw, goal_yaw + yaw])
    return dataclasses.replace(setup, scenario=dataclasses.replace(setup.scenario, start=start))


def longest_translation(setup: Setup, wanted: float | None) -> float:
    """m, of the pusher in an action.

    Args:
        setup: The scene.
        wanted: m; None for what the pusher's speed allows.

    Raises:
        ParameterError: It is not positive, or longer than the pusher's speed allows.
    """
    pusher = setup.scenario.pusher
    longest = pusher.horizon * pusher.max_speed
    if wanted is None:
        return longest
    if not 0 < wanted <= longest * (1 + _ROUNDING):
        allowed = f"more than 0, at most {longest:g} m, as horizon and max_speed of the pusher say"
        raise ParameterError(f"max_translation: got {wanted} m; allowed: {allowed}")
    return float(wanted)


def scene_hash(setup: Setup) -> str:
    """SHA-256 of a scenario and of its twin, which tells scenes apart wherever they lie."""
    scenario = dataclasses.asdict(setup.scenario)
    folder = scenario.pop("twin")
    digest = hashlib.sha256(json.dumps(scenario, sort_keys=True).encode())
    path = None if folder is None else Path(folder) / "twin.yaml"
    if path is not None and path.is_file():
        digest.update(path.read_bytes())  # it holds the hashes of the other files
    return digest.hexdigest()


def _scenario(scene: Scenario | str | Path) -> Scenario:
    if isinstance(scene, Scenario):
        return dataclasses.replace(scene, num_worlds=1)
    text = str(scene)
    if Path(text).is_dir():
        return _twin_scenario(text)
    return dataclasses.replace(load_scenario(scenario_path(text)), num_worlds=1)


def _twin_scenario(folder: str) -> Scenario:
    """The usual scene, with a twin in the place of the object."""
    usual, own = load_scenario(scenario_path(_USUAL)), read_setup(folder)
    floor = own.twin.floor_height
    high = [*usual.pusher.high[:2], usual.pusher.high[2] + floor]
    pusher = dataclasses.replace(
        usual.pusher, shape=None, low=[*usual.pusher.low[:2], usual.pusher.low[2] + floor], high=high
    )
    p_WC, p_WT = ([*point[:2], point[2] + floor] for point in (usual.camera.p_WC, usual.camera.p_WT))
    return dataclasses.replace(
        usual,
        name=own.twin.name,
        object=None,
        theta=None,
        twin=folder,
        pusher=pusher,
        camera=dataclasses.replace(usual.camera, p_WC=p_WC, p_WT=p_WT),
        start=dataclasses.replace(
            usual.start, q_WO=_without_yaw(own.scenario.start.q_WO), pusher_height=level_height(own)
        ),
    )


def _without_yaw(q: list[float]) -> list[float]:
    """The orientation q (4,) wxyz less its turn about z: a capture's yaw is of no concern to the task."""
    w, x, y, z = q
    length = math.hypot(w, z)
    if length < 1e-9:  # upside down: no turn about z to tell
        return q
    c, s = w / length, z / length
    # (c, 0, 0, -s) times q.
    return [length, c * x + s * y, c * y - s * x, 0.0]


def with_url(setup: Setup, url: str | None) -> Setup:
    """The setup with an address of LCM; None for the scenario's, which another process can reach."""
    link = setup.scenario.lcm
    chosen = url or (LOCAL if link.url == MEMORY else link.url)
    scenario = dataclasses.replace(setup.scenario, lcm=dataclasses.replace(link, url=chosen))
    return dataclasses.replace(setup, scenario=scenario)
