# SPDX-License-Identifier: MIT
"""A scene as it is at a lab's station: its table, camera, workspace, starts and delays."""

import dataclasses
import warnings
from typing import Any

import numpy as np

from pinwm_drake.capture.pusher import upright_shape
from pinwm_drake.errors import InputError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.station.document import Station, StationDocument
from pinwm_drake.systems.scenario.schema import View
from pinwm_drake.systems.scenario.setup import Setup, placed_task
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.systems.scenario.viewpoints import look_at
from pinwm_drake.twin.origin import Origin


def at_station(setup: Setup, station: Station) -> Setup:
    """Move a scene to a station.

    The scene's origin comes to the middle of the workspace, on the table. A twin of a capture of this station keeps the
    floor that it was identified with. The camera is the station's view. The pusher's box is cut to the workspace in x
    and y. Starts are those of the station; without any, those of the scene as far as the box has room.

    Args:
        setup: The scene.
        station: The station, with a fixed camera.

    Raises:
        InputError: The camera is in the hand, or the station has no square view, or its workspace is too small, or its
            view does not show the object at every start; the message names the key.
        ParameterError: The task cannot be moved.
    """
    about, scenario = station.document, setup.scenario
    origin = Origin.read(setup.twin)
    own = origin is not None and origin.station == station.sha256
    floor = setup.twin.floor_height if own else about.world.table.height
    x, y = (0.5 * (about.workspace.low[k] + about.workspace.high[k]) for k in (0, 1))
    moved = np.array([x, y, floor - setup.twin.floor_height])
    twin = dataclasses.replace(setup.twin, floor_height=floor)
    view = _view(station)
    low, high = (np.array(corner) + moved for corner in (scenario.pusher.low, scenario.pusher.high))
    low[:2] = np.maximum(low[:2], about.workspace.low[:2])
    high[:2] = np.minimum(high[:2], about.workspace.high[:2])
    start = dataclasses.replace(
        scenario.start,
        x=[end + x for end in scenario.start.x],
        y=[end + y for end in scenario.start.y],
        pusher_height=scenario.start.pusher_height + float(moved[2]),
    )
    task = setup.task.moved(x, y)
    placed = dataclasses.replace(
        setup,
        twin=twin,
        station=station.sha256,
        camera=Camera.from_field_of_view(view.width, view.height, view.fov_y),
        X_WC=look_at(np.array(view.p_WC), np.array(view.p_WT)),
        scenario=dataclasses.replace(
            scenario,
            camera=view,
            pusher=dataclasses.replace(scenario.pusher, low=low.tolist(), high=high.tolist()),
            start=start,
            task=task.to_document(),
        ),
    )
    _tell_tool(setup, station)
    placed = _with_start(placed, station)
    _check_seen(placed, station)
    return dataclasses.replace(placed, task=placed_task(task, placed.scenario, twin))


def latency_of(station: StationDocument) -> tuple[float, float]:
    """Shortest and longest time [s] from an image to the motion of its action.

    What is not known counts as none, and so does the part of an interval below 0.
    """
    known = [ends for ends in (station.latency.camera, station.latency.robot) if ends is not None]
    return sum(max(low, 0.0) for low, _ in known), sum(max(high, 0.0) for _, high in known)


def _view(station: Station) -> View:
    about = station.document.view
    if about is None:
        raise InputError(station.path, value="no view", allowed="p_WT, fov_y and size under view")
    width, height = about.size
    if width != height:
        raise InputError(station.path, value=f"view.size {width} x {height} px", allowed="as wide as high")
    p_WC = [float(value) for value in station.X_WC.p]
    return View(width, height, about.fov_y, p_WC, [float(value) for value in about.p_WT])


def _with_start(setup: Setup, station: Station) -> Setup:
    """Return the scene with starts that leave the pusher, beside the object, in its box."""
    scenario, start, given = setup.scenario, setup.scenario.start, station.document.start
    reach = start.pusher_gap[1] + upright_shape(setup.twin.pusher).radius
    reach += float(np.linalg.norm(load_mesh(setup.twin.mesh_path).vertices, axis=1).max())
    ranges: dict[str, Any] = {} if given is None else {"yaw": list(given.yaw)}
    for k, axis in enumerate("xy"):
        low, high = scenario.pusher.low[k] + reach, scenario.pusher.high[k] - reach
        if low > high:
            size = f"a workspace of {scenario.pusher.high[k] - scenario.pusher.low[k]:.3f} m along {axis}"
            allowed = f"{2 * reach:.3f} m or more, for the object and the pusher beside it"
            raise InputError(station.path, value=size, allowed=allowed)
        wanted = list(getattr(start if given is None else given, axis))
        ranges[axis] = [min(max(end, low), high) for end in wanted]
        if given is not None and (wanted[0] < low - 1e-9 or wanted[1] > high + 1e-9):
            allowed = f"{low:.3f} to {high:.3f} m, so that the pusher beside the object is in the workspace"
            raise InputError(station.path, value=f"start.{axis} {wanted[0]:.3f} to {wanted[1]:.3f} m", allowed=allowed)
    if given is None and (ranges["x"], ranges["y"]) != (start.x, start.y):
        found = ", ".join(f"{axis} {low:.3f} to {high:.3f} m" for axis, (low, high) in ranges.items())
        warnings.warn(f"{station.path}: the workspace has room for starts at {found} alone", stacklevel=3)
    start = dataclasses.replace(start, **ranges)
    return dataclasses.replace(setup, scenario=dataclasses.replace(scenario, start=start))


def _check_seen(setup: Setup, station: Station) -> None:
    """Raise InputError where the view does not show all of the object at the ends of its starts."""
    distribution, camera, X_WC = StartDistribution(setup), setup.camera, setup.X_WC
    numbers, size = camera.intrinsics.numpy(), (camera.width, camera.height)
    view = ViewCamera(X_WC.rotation().matrix(), X_WC.translation(), numbers[:2], *size, numbers[2:])
    for place in distribution.extremes():
        pixels, depth = view.project(place.X_WO.multiply(distribution.vertices.T).T)
        if (depth <= 0.0).any() or (pixels < 0.0).any() or (pixels > size).any():
            x, y, _ = place.X_WO.translation()
            raise InputError(
                station.path,
                value=f"a view that does not show the whole object at x {x:.3f}, y {y:.3f} m",
                allowed="all starts in view, by start, view.fov_y and view.p_WT",
            )


def _tell_tool(setup: Setup, station: Station) -> None:
    """Warn where the station's tool is another than the pusher that is trained with."""
    tool, pusher = station.document.tool, setup.twin.pusher
    shape = None if tool.shape is None else tool.shape.shape()
    if (shape is not None and shape != pusher.shape) or (shape is None and tool.mesh and pusher.mesh_path is None):
        named = "a mesh" if shape is None else f"a {shape.kind} of {1e3 * shape.radius:g} mm"
        words = f"the tool is {named}; training keeps the pusher of {setup.scenario.name}"
        warnings.warn(f"{station.path}: {words}", stacklevel=3)
