# SPDX-License-Identifier: MIT
"""A scenario with everything that its engines need: geometry, theta, appearance and camera, alike for each of them."""

import dataclasses
import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import RenderEngineVtkParams
from pydrake.math import RigidTransform

from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.geometry.stored_pieces import mesh_primitives
from pinwm_drake.models import object_model
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.painted import painted_surfels
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.systems.sampling import whole_multiple
from pinwm_drake.systems.scenario.schema import Scenario, Theta, check_scenario
from pinwm_drake.systems.scenario.viewpoints import look_at
from pinwm_drake.tasks.registry import task_from_document
from pinwm_drake.tasks.task import Task
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.twin import THETA, Estimate, Twin

_TIME_STEP, _GRAVITY = 1 / 240, 9.81
_LONGEST_PLANT_STEP = 1 / 3840  # s
_SHARE = 1e-6  # share of a period by which a multiple may be missed


@dataclass(frozen=True, eq=False)
class Setup:
    """Everything of a scene that engines are built from.

    Attributes:
        scenario: The scenario.
        twin: Geometry, theta, settings of the physics, and appearance; from a folder, or made for an object.
        visual_path: File of the object's coloured mesh, m, frame O, for Drake's renderers.
        camera: Camera of the `rgb` port; intrinsics (4,) px.
        X_WC: Pose of the camera in the world, OpenCV axes.
        period: s, at which the pusher's velocity is sampled; also that of the twin's updates.
        plant_time_step: s, one step of Drake's plants; a whole number of them make a period.
        task: The scenario's task, with the object's orientation `scenario.start.q_WO`.
        renderer: Settings of the renderer of Drake's plants; None for even light from all sides.
        station: SHA-256 of the `station.yaml` of the lab's station that the scene is at; None for none.
    """

    scenario: Scenario
    twin: Twin
    visual_path: Path
    camera: Camera
    X_WC: RigidTransform
    period: float
    plant_time_step: float
    task: Task
    renderer: RenderEngineVtkParams | None = None
    station: str | None = None

    def with_theta(self, **values: float) -> "Setup":
        """Return the setup with other values of the twin's parameters; see `Twin.with_theta`.

        Args:
            values: Values by name, in SI units.

        Raises:
            ParameterError: There is no such parameter.
        """
        return dataclasses.replace(self, twin=self.twin.with_theta(**values))


def make_setup(scenario: Scenario, *, twin: Twin | None = None) -> Setup:
    """Make the setup of a scenario: read its files, and check its values.

    Args:
        scenario: The scenario.
        twin: A twin in memory, in the place of the scenario's object or twin; None for the scenario's.

    Raises:
        InputError: The scenario is out of range, or one of its files cannot be used.
        ParameterError: Periods and time steps do not divide each other.
    """
    if twin is not None:
        scenario = dataclasses.replace(scenario, object=None, theta=None, twin=str(scenario.twin or twin.name))
    check_scenario(Path(scenario.name), dataclasses.asdict(scenario))
    if twin is not None:
        visual_path = twin.mesh_path
    elif scenario.twin is not None:
        twin = load_twin(Path(scenario.twin))
        visual_path = twin.mesh_path
    else:
        twin, visual_path = _twin_of_object(scenario)
    twin = _with_settings(twin, scenario)
    view, update = scenario.camera, twin.time_step * scenario.physics.steps_per_update
    period = scenario.pusher.period or update
    if not math.isclose(period, update, rel_tol=_SHARE):
        raise ParameterError(f"pusher.period: got {period:g} s; allowed: {update:g} s, that of the twin's updates")
    step = scenario.plant.time_step or period / math.ceil(period / _LONGEST_PLANT_STEP - _SHARE)
    whole_multiple("pusher.period", period, step, "plant.time_step")
    return Setup(
        scenario=scenario,
        twin=twin,
        visual_path=visual_path,
        camera=Camera.from_field_of_view(view.width, view.height, view.fov_y),
        X_WC=look_at(np.array(view.p_WC), np.array(view.p_WT)),
        period=period,
        plant_time_step=step,
        task=placed_task(task_from_document(scenario.task), scenario, twin),
    )


def placed_task(task: Task, scenario: Scenario, twin: Twin) -> Task:
    """Return the task with what it takes from a scene: the object's start and size, and the floor's height.

    Raises:
        InputError: The mesh cannot be used.
    """
    return task.placed(scenario.start.q_WO, load_mesh(twin.mesh_path).vertices, twin.floor_height)


@functools.lru_cache(maxsize=8)
def _painted(visual_path: Path) -> Surfels:
    """Appearance of an object that ships, which many setups have."""
    return painted_surfels(visual_path)


def _twin_of_object(scenario: Scenario) -> tuple[Twin, Path]:
    model = object_model(str(scenario.object))
    theta, provenance = scenario.theta or Theta(), {"scenario": scenario.name}
    return given_twin(model.name, model.mesh_path, model.visual_path, theta, provenance), model.visual_path


def given_twin(name: str, mesh_path: Path, visual_path: Path, theta: Theta, provenance: dict[str, Any]) -> Twin:
    """Twin of an object whose physical parameters are given: inertia of its mesh, and painted surfels.

    Args:
        name: Name of the object.
        mesh_path: Closed mesh, m, frame O, origin at the centre of mass.
        visual_path: The same surface in colours, as `painted_surfels` takes it.
        theta: Mass and coefficients.
        provenance: Plain data.

    Raises:
        InputError: One of the meshes cannot be used.
    """
    inertia = mass_properties(load_mesh(mesh_path), mass=theta.mass).inertia
    values = {
        "mass": theta.mass,
        **{f"inertia_{2 * axis}": float(inertia[k, k]) for k, axis in enumerate("xyz")},
        "friction_floor": theta.friction_floor,
        "friction_pusher": theta.friction_pusher,
        "restitution_floor": theta.restitution,
        "restitution_pusher": theta.restitution,
    }
    return Twin(
        name=name,
        mesh_path=mesh_path,
        pusher=PusherGeometry(None, PusherShape("sphere", 0.01)),
        gravity=_GRAVITY,
        floor_height=0.0,
        time_step=_TIME_STEP,
        support="patch",
        theta={name: Estimate(values[name], None, True, unit, "given") for name, unit in THETA.items()},
        nuisance={},
        camera_offset=(0.0, 0.0),
        surfels=_painted(visual_path),
        provenance=provenance,
        acts_as=mesh_primitives(mesh_path),
    )


def _with_settings(twin: Twin, scenario: Scenario) -> Twin:
    physics, shape = scenario.physics, scenario.pusher.shape
    changes: dict[str, Any] = {
        "time_step": physics.time_step,
        "support": physics.support,
        "gravity": scenario.gravity,
    }
    if physics.facets is not None:
        changes["acts_as"] = () if physics.facets else mesh_primitives(twin.mesh_path)
    if shape is not None:
        changes["pusher"] = PusherGeometry(None, PusherShape(shape.kind, shape.radius, shape.length))
    return dataclasses.replace(twin, **{name: value for name, value in changes.items() if value is not None})
