# SPDX-License-Identifier: MIT
"""Specification of a policy from a scene, and the environment in which such a policy can act."""

import dataclasses
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform

from pinwm_drake.capture.pusher import upright_shape
from pinwm_drake.errors import ParameterError, require
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.learning.images.window import window_size
from pinwm_drake.learning.spec import CameraSpec, ObjectSpec, Observes, PolicySpec, PusherSpec, SceneSpec
from pinwm_drake.models import shipped_scenarios
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.systems.envs.env import TaskEnv, changed_options
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup, longest_translation
from pinwm_drake.systems.scenario.load import Scene, load_setup
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.tasks.registry import changed_task, recipe_of

# Largest distances of a scene's camera from the policy's: an identified floor lies within a millimetre of the true one.
_OFF, _TURNED = 2e-3, 5e-3  # m, rad
_SHARE = 1e-6


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


def usual_scene(spec: PolicySpec) -> str:
    """Name of the scenario that ships for a policy's task and object, or for its task where none is of the object."""
    name = "" if spec.scene is None else f"{spec.task.name}_{spec.scene.object.name}"
    return name if name in shipped_scenarios() else recipe_of(spec.task).scene


def spec_environment(
    spec: PolicySpec,
    scene: Scene,
    engine: str | None = None,
    *,
    truth: Callable[[Setup], Setup] | None = None,
    **changes: Any,
) -> TaskEnv:
    """Make the environment of a scene in which a policy has the observations and actions that it is made for.

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


def check_object(spec: PolicySpec, setup: Setup) -> None:
    """Check that a scene has the object, pusher and floor that a policy is made for, as far as those are known.

    Args:
        spec: Specification of the policy.
        setup: The scene.

    Raises:
        InputError: A mesh of the scene cannot be used.
        ParameterError: The object's mesh or the pusher is another, or the floor is more than 2 mm off.
    """
    if spec.scene is None:
        return
    found, allowed = scene_spec(setup), spec.scene
    all_the_same = "the policy's; --force controls it all the same"
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
