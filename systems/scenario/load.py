# SPDX-License-Identifier: MIT
"""Scenes by name: every way to name a scene leads to one `Setup`, made once, and only that travels from there."""

import dataclasses
import hashlib
import json
import math
from pathlib import Path
from typing import TypeAlias

import numpy as np

from pinwm_drake.capture.scene import load_capture
from pinwm_drake.errors import InputError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import PACKAGE_NAME, SCENARIO_SUFFIX, object_model, shipped_scenarios, twin_path
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.systems.scenario.schema import LOCAL, MEMORY, Scenario, load_scenario
from pinwm_drake.systems.scenario.setup import Setup, make_setup
from pinwm_drake.systems.scenario.start import level_height
from pinwm_drake.tasks import DEFAULT_TASK
from pinwm_drake.tasks.registry import recipe_of
from pinwm_drake.twin.origin import Origin
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.twin import Twin

Scene: TypeAlias = Setup | Scenario | str | Path
_FOLDER = "scenarios/"
_LARGE = 1.2  # times as large as that scene's own object, from which on the camera is moved away


def load_setup(scene: Scene, *, twin: str | Path | None = None) -> Setup:
    """Load a scene; commands, environments and notebooks all do it here.

    A twin's folder stands for the scene of push_t with the twin's object and pusher: the object lies as in the capture
    that it was identified from (as its mesh does where that is gone), without that capture's turn about z; the pusher
    is as high as the object's centre of mass; the pusher's box and the camera are as much higher as the twin's floor
    is, and the camera is farther away where the object is more than 1.2 times as large as the T-block.

    Args:
        scene: A setup, which is returned as it is; a scenario; the name of one that ships; its file or `package://`
            URL; or the folder of a twin, or the name of one that ships.
        twin: Folder of a twin that takes the place of the scenario's object; None for the scenario's own.

    Returns:
        The setup, of as many worlds as a scenario says that is given as an object, else of one.

    Raises:
        InputError: There is no such scene, or one of its files cannot be used.
        ParameterError: Periods and time steps of the scenario do not divide each other.
    """
    if isinstance(scene, Setup):
        return scene
    if isinstance(scene, Scenario):
        scenario = scene
    elif (folder := twin_path(scene)).is_dir():
        if twin is not None:
            raise InputError(scene, value=f"a twin's folder beside the twin {twin}", allowed="one of the two")
        scenario = _twin_scenario(str(folder))
    else:
        scenario = dataclasses.replace(load_scenario(scenario_path(str(scene))), num_worlds=1)
    if twin is not None:
        scenario = dataclasses.replace(scenario, object=None, theta=None, twin=str(twin))
    return make_setup(scenario)


def scenario_path(text: str) -> str:
    """File or URL of a scenario that a user names, as `load_scenario` takes it.

    Args:
        text: A scenario's file, the name of one that ships, or a `package://` URL.

    Raises:
        InputError: There is no such file, and none of that name.
    """
    if text in shipped_scenarios() and not Path(text).exists():
        return f"package://{PACKAGE_NAME}/{_FOLDER}{text}{SCENARIO_SUFFIX}"
    if "://" not in text and not Path(text).exists():
        allowed = f"a file, a twin's folder, or one of {', '.join(shipped_scenarios())}"
        raise InputError(text, value="no such scenario", allowed=allowed)
    return text


def with_url(setup: Setup, url: str | None) -> Setup:
    """Return the setup with an address of LCM that another process can reach.

    Args:
        setup: The scene.
        url: The address; None for that of the scenario, or `LOCAL` where that stays within the process.
    """
    link = setup.scenario.lcm
    chosen = url or (LOCAL if link.url == MEMORY else link.url)
    scenario = dataclasses.replace(setup.scenario, lcm=dataclasses.replace(link, url=chosen))
    return dataclasses.replace(setup, scenario=scenario)


def scene_hash(setup: Setup) -> str:
    """SHA-256 of a scenario and of its twin, which tells scenes apart in any folder; the task is left out.

    One scene serves many tasks, whose documents stand beside the hash wherever results are kept.
    """
    scenario = dataclasses.asdict(setup.scenario)
    folder = scenario.pop("twin")
    scenario.pop("task")
    scenario["physics"]["friction_directions"] = None  # as in version 0.1, whose hashes stand in files
    digest = hashlib.sha256(json.dumps(scenario, sort_keys=True).encode())
    path = None if folder is None else Path(folder) / "twin.yaml"
    if path is not None and path.is_file():
        digest.update(read_bytes(path))  # it holds the hashes of the other files
    return digest.hexdigest()


def _twin_scenario(folder: str) -> Scenario:
    usual, twin = load_scenario(scenario_path(recipe_of(DEFAULT_TASK).scene)), load_twin(Path(folder))
    floor = np.array([0.0, 0.0, twin.floor_height])
    size = _reach(twin.mesh_path) / _reach(object_model(str(usual.object)).mesh_path)
    size = size if size > _LARGE else 1.0
    camera, pusher = usual.camera, usual.pusher
    scenario = dataclasses.replace(
        usual,
        name=twin.name,
        object=None,
        theta=None,
        twin=folder,
        pusher=dataclasses.replace(
            pusher, shape=None, low=(pusher.low + floor).tolist(), high=(pusher.high + floor).tolist()
        ),
        camera=dataclasses.replace(
            camera,
            p_WC=(size * np.array(camera.p_WC) + floor).tolist(),
            p_WT=(size * np.array(camera.p_WT) + floor).tolist(),
        ),
        start=dataclasses.replace(usual.start, q_WO=_without_yaw(_lies(twin))),
    )
    height = level_height(make_setup(scenario))
    return dataclasses.replace(scenario, start=dataclasses.replace(scenario.start, pusher_height=height))


def _reach(mesh_path: Path) -> float:
    return float(np.linalg.norm(load_mesh(mesh_path).vertices, axis=1).max())


def _lies(twin: Twin) -> list[float]:
    """Orientation q_WO (4,) wxyz of the object in the capture that a twin is from; the identity where that is gone."""
    origin = Origin.read(twin)
    if origin is not None:
        try:
            return [float(value) for value in load_capture(origin.path).object.X_WO.q]
        except InputError:  # moved, or changed
            pass
    return [1.0, 0.0, 0.0, 0.0]


def _without_yaw(q: list[float]) -> list[float]:
    """Return the orientation q (4,) wxyz less its turn about z: a capture's yaw is of no concern to a task."""
    w, x, y, z = q
    length = math.hypot(w, z)
    if length < 1e-9:  # upside down: no turn about z to tell
        return q
    c, s = w / length, z / length
    # (c, 0, 0, -s) times q.
    return [length, c * x + s * y, c * y - s * x, 0.0]
