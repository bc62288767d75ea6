# SPDX-License-Identifier: MIT
"""Specification of a policy from a scene, and the environment in which such a policy can act."""

import dataclasses
import hashlib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform

from pinwm_drake.capture.pusher import upright_shape
from pinwm_drake.errors import InputError, ParameterError, require
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.learning.images.window import window_size
from pinwm_drake.learning.spec import CameraSpec, ObjectSpec, Observes, PolicySpec, PusherSpec, SceneSpec
from pinwm_drake.models import shipped_scenarios, twin_path
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.station.document import load_station
from pinwm_drake.station.named import require_station
from pinwm_drake.systems.envs.env import TaskEnv, changed_options
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup, longest_translation
from pinwm_drake.systems.scenario.at_station import at_station
from pinwm_drake.systems.scenario.load import Scene, load_setup
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.tasks.registry import changed_task, recipe_of

# Largest distances of a scene's camera from the policy's: an identified floor lies within a millimetre of the true one.
_OFF, _TURNED = 2e-3, 5e-3  # m, rad
_SHARE = 1e-6
_ALIKE = 0.1  # of the sizes of an object and of its scanned mesh
FORCE = "--force controls it all the same"
OTHER_OBJECT = "--other-object evaluates it all the same"


def policy_spec(setup: Setup, options: EnvOptions, observes: Observes) -> PolicySpec:
    """Specification of a policy that is trained in a scene.

    Args:
        setup: The scene, as `environment_setup` makes it.
        options: Options of which frames, history, longest translation and number of steps count; the task is the
            setup's.
        observes: "rgb" or "state".

    Raises:
        ParameterError: A value is out of range.
    """
    scenario, camera, task = setup.scenario, setup.camera, setup.task
    fx, fy, cx, cy = (float(value) for value in camera.intrinsics)
    low, high = (np.array(corner)[task.axis_indices] for corner in (scenario.pusher.low, scenario.pusher.high))
    spec = PolicySpec(
        observes=observes,
        frames=options.frames,
        camera=CameraSpec(
            width=camera.width,
            height=camera.height,
            fx=fx,
            fy=fy,
            cx=cx,
            cy=cy,
            p_WC=_floats(setup.X_WC.translation()),
            q_WC=_floats(setup.X_WC.rotation().ToQuaternion().wxyz()),
        ),
        horizon=float(scenario.pusher.horizon),
        max_translation=longest_translation(setup, options.max_translation),
        pusher_low=_floats(low),
        pusher_high=_floats(high),
        pusher_height=float(scenario.start.pusher_height),
        task=task,
        max_steps=task.max_steps if options.max_steps is None else int(options.max_steps),
        scene=scene_spec(setup),
        history=options.history,
        station=setup.station,
        latency=(float(options.latency[0]), float(options.latency[1])),
        lag=(float(options.lag[0]), float(options.lag[1])),
        acceleration=options.acceleration if math.isfinite(options.acceleration) else None,
    )
    return dataclasses.replace(spec, window=window_size(spec)) if observes == "rgb" else spec


def scene_spec(setup: Setup, camera: CameraSpec | None = None) -> SceneSpec:
    """Object, pusher and floor of a scene, for a policy's specification.

    Args:
        setup: The scene.
        camera: Camera of a policy that was trained in a scene like this; the floor is told to be as far below it as
            the scene's own is below the scene's camera. None for the scene's camera.

    Raises:
        InputError: A mesh of the scene cannot be used.
    """
    twin, low_high = setup.twin, load_mesh(setup.twin.mesh_path).bounds
    low, high = (np.round(corner, 9) for corner in low_high)  # nm: what reading a mesh leaves is no size
    shape, mesh = upright_shape(twin.pusher), None
    if twin.pusher.shape is None and twin.pusher.mesh_path is not None:
        mesh = _sha256(twin.pusher.mesh_path)
    higher = 0.0 if camera is None else camera.p_WC[2] - float(setup.X_WC.translation()[2])
    return SceneSpec(
        object=ObjectSpec(
            name=twin.name,
            mesh_sha256=_sha256(twin.mesh_path),
            size=_floats(np.round(high - low, 9)),
            middle=_floats(np.round(0.5 * (low + high), 9)),
        ),
        pusher=PusherSpec("mesh" if mesh else shape.kind, float(shape.radius), float(shape.length), mesh),
        floor_height=float(twin.floor_height) + higher,
    )


def scene_record(scene: str, in_scene: str | None, station: Path | None = None) -> dict[str, str]:
    """Where a policy was trained, for its provenance: `home_scene` finds the scene again by it.

    Args:
        scene: Scene of the training: a twin's folder, or a scenario's file or name.
        in_scene: Scenario that the twin was placed in; None for its own.
        station: The `station.yaml` that it was trained for; None for none.
    """

    def told(text: str) -> str:
        return str(Path(text).resolve()) if Path(text).exists() else text

    at = {} if station is None else {"station": told(str(station))}
    return at | ({"scene": told(scene)} if in_scene is None else {"scene": told(in_scene), "twin": told(scene)})


def home_scene(spec: PolicySpec, provenance: Mapping[str, Any], folder: str | Path) -> Setup:
    """Scene of a policy's own: that of its training, or the one that ships for its task and object.

    A scene that has moved together with the policy's folder is found beside it.

    Args:
        spec: Specification of the policy.
        provenance: Provenance of the policy or bundle.
        folder: Folder of the policy or bundle, or its name.

    Raises:
        InputError: There is no such scene any more, or the policy does not tell it, or a file of it cannot be used.
        ParameterError: The scene has another object, pusher or floor by now.
    """
    about = provenance.get("policy", provenance)
    recorded = about.get("home") if isinstance(about, Mapping) else None
    if isinstance(recorded, Mapping) and "scene" in recorded:
        scene, twin = (_found(recorded.get(key), Path(folder)) for key in ("scene", "twin"))
        if scene is None or ("twin" in recorded and twin is None):
            lost = recorded["scene"] if scene is None else recorded["twin"]
            raise InputError(
                folder,
                value=f"no scene of its training at {lost}",
                allowed=f"--scene with {_wanted(spec)}",
            )
        setup = load_setup(scene, twin=twin)
        if "station" in recorded:
            file = _found(recorded["station"], Path(folder))
            if file is None:
                lost = f"no station of its training at {recorded['station']}"
                raise InputError(folder, value=lost, allowed=f"--scene with {_wanted(spec)}")
            station = load_station(Path(file))
            require_station(folder, spec.station, station.sha256, station.path)
            setup = at_station(setup, station)
        check_object(spec, setup)
        return setup
    trained = about.get("trained_in") if isinstance(about, Mapping) else None
    named = trained.get("scene") if isinstance(trained, Mapping) else None
    for name in dict.fromkeys([named, *usual_scenes(spec)]):
        if name not in shipped_scenarios() or spec.scene is None:
            continue
        setup = load_setup(name)
        if scene_spec(setup).object.mesh_sha256 == spec.scene.object.mesh_sha256:
            return setup
    raise InputError(folder, value="a policy that does not tell its scene", allowed=f"--scene with {_wanted(spec)}")


def usual_scenes(spec: PolicySpec) -> list[str]:
    """Names of scenarios that may ship for a policy: that of its task and object, and that of its task."""
    named = [] if spec.scene is None else [f"{spec.task.name}_{spec.scene.object.name}"]
    return [*named, recipe_of(spec.task).scene]


def policy_setup(
    spec: PolicySpec, provenance: Mapping[str, Any], folder: str | Path, scene: Scene | None, force: str | None = FORCE
) -> Setup:
    """Scene for a policy: the one that is named, or its own; see `home_scene`.

    Args:
        spec: Specification of the policy.
        provenance: Provenance of the policy or bundle.
        folder: Folder of the policy or bundle, or its name.
        scene: Scene that is named; None for the policy's own.
        force: What the refusal of another object names as the way to have it; None where it is not refused.

    Raises:
        InputError: There is no such scene, or one of its files cannot be used.
        ParameterError: The scene has another object, pusher or floor than the policy was trained with.
    """
    if scene is None:
        return home_scene(spec, provenance, folder)
    setup = load_setup(scene)
    if force is not None:
        check_object(spec, setup, force)
    return setup


def _found(text: str | None, folder: Path) -> str | None:
    """Return a recorded scene as it can be loaded: where it was, or beside the policy's folder; None for neither."""
    if text is None or "://" in text or Path(text).exists() or text in shipped_scenarios():
        return text
    if twin_path(text).is_dir():
        return text
    parts = Path(text).parts
    beside = (folder.resolve().parent.joinpath(*parts[-k:]) for k in range(1, len(parts)))
    return next((str(path) for path in beside if path.exists()), None)


def _wanted(spec: PolicySpec) -> str:
    known = "of its object" if spec.scene is None else f"of {_object_words(spec.scene.object)}"
    return f"the twin or scenario {known}"


def spec_environment(
    spec: PolicySpec,
    scene: Scene,
    engine: str | None = None,
    *,
    truth: Callable[[Setup], Setup] | None = None,
    **changes: Any,
) -> TaskEnv:
    """Make the environment of a scene in which a policy has the observations and actions that it is made for.

    The pusher has the policy's largest acceleration. Actions are at once, unless `changes` say so.

    Args:
        spec: Specification of the policy.
        scene: A setup, a scenario, the name or path of one, or the folder of a twin; see `load_setup`.
        engine: "twin", "hydroelastic" or "point"; None for that of the scenario.
        truth: Gives the scene that is simulated from the one that is believed in and checked; None where both are one.
        changes: Fields of `EnvOptions` in the place of the specification's; a mapping as `task` changes the policy's.

    Raises:
        InputError: The scene, or one of its files, cannot be used.
        ParameterError: The scene's camera, pusher's box or horizon is not that of the policy, or an option is none of
            those allowed.
    """
    camera = spec.camera
    require("camera", f"{camera.width} by {camera.height} px", camera.width == camera.height, "as wide as high")
    options = EnvOptions(
        observation="state" if spec.observes == "state" else "rgb",
        frames=spec.frames,
        task=changed_task(spec.task, changes.pop("task", None)),
        max_steps=spec.max_steps,
        max_translation=spec.max_translation,
        image_size=camera.width,
        history=spec.history,
        acceleration=spec.acceleration or math.inf,
    )
    if truth is None:
        environment = TaskEnv(scene, engine, options, **changes)
        check_scene(spec, environment.setup)
        return environment
    believed, options = load_setup(scene), changed_options(options, changes)
    check_scene(spec, environment_setup(believed, options))
    return TaskEnv(truth(believed), engine, options)


def check_scene(spec: PolicySpec, setup: Setup) -> None:
    """Check that a scene is one that a policy is made for.

    Args:
        spec: Specification of the policy.
        setup: The scene.

    Raises:
        ParameterError: The scene's camera (with images), pusher's box or horizon is not that of the policy.
    """
    scenario, camera = setup.scenario, spec.camera
    if abs(scenario.pusher.horizon - spec.horizon) > _SHARE:
        raise ParameterError(f"horizon: got {scenario.pusher.horizon:g} s; allowed: {spec.horizon:g} s, the policy's")
    axes = spec.task.axis_indices
    box = [*np.array(scenario.pusher.low)[axes].tolist(), *np.array(scenario.pusher.high)[axes].tolist()]
    if not np.allclose(box, [*spec.pusher_low, *spec.pusher_high], rtol=0, atol=_SHARE):
        raise ParameterError(
            f"pusher's box: got {box} m; allowed: the policy's, {spec.pusher_low} to {spec.pusher_high}"
        )
    if spec.observes == "state":
        return
    intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy]
    size = (setup.camera.width, setup.camera.height)
    if size != (camera.width, camera.height) or not np.allclose(setup.camera.intrinsics, intrinsics, rtol=_SHARE):
        given = f"{size[0]} by {size[1]} px, fx {float(setup.camera.intrinsics[0]):g}"
        allowed = f"the policy's, {camera.width} by {camera.height} px, fx {camera.fx:g}"
        raise ParameterError(f"camera: got {given}; allowed: {allowed}")
    q_WC = np.array(camera.q_WC)
    X_WC = RigidTransform(Quaternion(wxyz=q_WC / np.linalg.norm(q_WC)), camera.p_WC)
    X = X_WC.inverse() @ setup.X_WC
    off, turned = float(np.linalg.norm(X.translation())), abs(X.rotation().ToAngleAxis().angle())
    if off > _OFF or turned > _TURNED:
        raise ParameterError(
            f"camera: got one {1e3 * off:.1f} mm and {turned:.4f} rad from the policy's; "
            f"allowed: {1e3 * _OFF:g} mm and {_TURNED:g} rad"
        )


def check_object(spec: PolicySpec, setup: Setup, force: str = FORCE) -> None:
    """Check that a scene has the object, pusher and floor that a policy is made for, as far as those are known.

    Args:
        spec: Specification of the policy.
        setup: The scene.
        force: What the message names as the way to have another one.

    Raises:
        InputError: A mesh of the scene cannot be used.
        ParameterError: The object's mesh or the pusher is another, or the floor is more than 2 mm off.
    """
    if spec.scene is None:
        return
    found, allowed = scene_spec(setup), spec.scene
    all_the_same = f"the policy's; {force}"
    if found.object.mesh_sha256 != allowed.object.mesh_sha256:
        given, wanted = _object_words(found.object), _object_words(allowed.object)
        if given == wanted:
            given += f", mesh {found.object.mesh_sha256[:8]}"
            wanted += f", mesh {allowed.object.mesh_sha256[:8]}"
        raise ParameterError(f"object: got {given}; allowed: {wanted}, {all_the_same}")
    given, wanted = _pusher_words(found.pusher), _pusher_words(allowed.pusher)
    sizes, others = ([pusher.radius, pusher.length] for pusher in (found.pusher, allowed.pusher))
    same = dataclasses.replace(found.pusher, radius=allowed.pusher.radius, length=allowed.pusher.length)
    if same != allowed.pusher or not np.allclose(sizes, others, rtol=0, atol=_SHARE):
        raise ParameterError(f"pusher: got {given}; allowed: {wanted}, {all_the_same}")
    if abs(found.floor_height - allowed.floor_height) > _OFF:
        raise ParameterError(
            f"floor: got {1e3 * found.floor_height:.1f} mm; allowed: {1e3 * allowed.floor_height:.1f} mm, "
            f"give or take {1e3 * _OFF:g} mm, {all_the_same}"
        )


def require_same_object(name: str, setup: Setup, other_name: str, other: Setup) -> None:
    """Raise ParameterError where two scenes, of these names, have objects of other sizes."""
    given, wanted = (scene_spec(one).object for one in (setup, other))
    if not np.allclose(given.size, wanted.size, rtol=_ALIKE):
        allowed = f"{_object_words(wanted)}, that of {other_name}; {OTHER_OBJECT}"
        raise ParameterError(f"{name}: got {_object_words(given)}; allowed: {allowed}")


def _object_words(about: ObjectSpec) -> str:
    return f"{about.name}, {' x '.join(f'{1e3 * extent:.4g}' for extent in about.size)} mm"


def _pusher_words(about: PusherSpec) -> str:
    length = f", {1e3 * about.length:.4g} mm long" if about.length else ""
    mesh = f", {about.mesh_sha256[:8]}" if about.mesh_sha256 else ""
    return f"a {about.shape} of {1e3 * about.radius:.4g} mm{length}{mesh}"


def _sha256(path: Path) -> str:
    return hashlib.sha256(read_bytes(path)).hexdigest()


def _floats(values: Any) -> Any:
    return tuple(float(value) for value in values)
