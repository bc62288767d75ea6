# SPDX-License-Identifier: MIT
"""Identification of a twin from one push or more and an appearance: theta with intervals, through the images."""

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from pinwm_drake.capture.episodes import Episode, ObjectPoses
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import Capture
from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.floor import LYING
from pinwm_drake.geometry.meshes import half_diagonal
from pinwm_drake.geometry.patch import corner_spread
from pinwm_drake.geometry.pieces import EVEN_SHARE
from pinwm_drake.geometry.stored_pieces import mesh_primitives
from pinwm_drake.identification.forward import Forward
from pinwm_drake.identification.locate import LIMIT, find_start
from pinwm_drake.identification.mass import find_mass_scale, with_mass
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.pictures import read_footage
from pinwm_drake.identification.posterior import estimates, kept_draws
from pinwm_drake.identification.search import Outcome, Progress, Search, Task, frame_numbers
from pinwm_drake.identification.time_step import time_step_of
from pinwm_drake.identification.unknowns import UNKNOWNS, Coordinates
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.scene import Scene, make_scene, resting_height
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_to_matrix
from pinwm_drake.threads import one_torch_thread
from pinwm_drake.twin.document import to_plain
from pinwm_drake.twin.frame import confusion
from pinwm_drake.twin.origin import Origin, registration_entry, seen_in
from pinwm_drake.twin.rollout import SUPPORT
from pinwm_drake.twin.twin import Twin, assemble_twin

# Options that a continued search may have otherwise; threads count with the number that is used.
_MAY_CHANGE = ("checkpoint_every", "num_threads")
NOMINAL_MASS = 1.0  # kg, where none was measured
_CLOCK = 1e-3  # s, of an offset that was found, at least: exposures are not instants
_LINES = ("cylinder", "capsule")  # lie on a line
# Standard deviation of the centre of mass of an object on a round side, as a share of half of its diagonal.
_CENTER_SHARE = 0.07


@dataclass(frozen=True, eq=False)
class Identification:
    """Identified twin, and the course of its identification.

    Attributes:
        twin: The twin; its provenance lacks entries that only the caller knows, such as the command.
        found: The search.
        poses: Poses of the object in the frames of each push, by the twin.
    """

    twin: Twin
    found: Outcome
    poses: list[ObjectPoses]


def identify_theta(
    capture: Capture,
    episodes: Episode | Sequence[Episode],
    surfels: Surfels,
    camera_offset: tuple[float, float],
    options: IdentifyOptions | None = None,
    *,
    X_OS: Pose | None = None,
    folder: Path | None = None,
    resume: bool = False,
    report: Callable[[Progress], None] = lambda _: None,
) -> Identification:
    """Find theta such that physics and renderer reproduce the videos of one push or several.

    No pose is used: of the episodes, cameras, images, times and the pusher's trajectory. Theta and the nuisances of the
    object are shared by all pushes; start pose, clock and outline are of each its own. Where the mass is neither given
    nor an unknown, forces in the trajectories tell it; see `mass.py`.

    Args:
        capture: Object, pusher, floor, gravity.
        episodes: The push, or the pushes.
        surfels: The object's appearance, frame O.
        camera_offset: px, added to the principal points of the episodes' cameras.
        options: Options of the search.
        X_OS: Where the static views have the object, against the pose in `capture.yaml`; None for the latter.
        folder: Folder of the checkpoints; None for none.
        resume: Whether to go on from a checkpoint in `folder`.
        report: Called after each step.

    Returns:
        The twin and the search.

    Raises:
        InputError: Images or meshes cannot be used, or a checkpoint is of another identification.
        ParameterError: There is no episode, or one comes twice.
        SolverError: The physics found no solution.

    Source: PIN-WM (Li et al., 2025), eq. 8; deviations in `image_loss.py`, `discrepancy.py` and `search.py`.
    """
    options = options or IdentifyOptions()
    pushes = distinct_pushes(episodes)
    origin, written = Origin.of(capture, pushes), capture.object.X_WO
    capture = capture if X_OS is None else seen_in(capture, X_OS)
    number, step = options.threads, options.time_step or time_step_of(pushes)
    mass = given_mass(capture, options)
    with one_torch_thread():
        scene = capture_scene(capture, step, facets=options.facets)
        pusher = pusher_surface(capture.pusher)
        footages = [read_footage(episode, pusher, camera_offset, frame_numbers(episode, options)) for episode in pushes]
        radius, X_WO = half_diagonal(scene.mesh), capture.object.X_WO
        own = [X_WO if episode.start is None else episode.start for episode in pushes]
        starts = [
            find_start(footage, surfels, start, radius, num_threads=number)
            for footage, start in zip(footages, own, strict=True)
        ]
        coordinates = _coordinates(capture, options, scene, mass, starts, pushes)
        forwards = [
            Forward(scene, episode, start, mass, number, pivot=written.p)
            for episode, start in zip(pushes, own, strict=True)
        ]
        task = Task(footages, forwards, surfels, coordinates, starts, number)
        about = {
            "capture": origin.sha256,
            "episodes": [push.name for push in pushes],
            "camera_offset": list(camera_offset),
            "surfels": _digest(surfels),
            "X_WO": [*X_WO.q.tolist(), *X_WO.p.tolist()],
            "num_threads": number,
            "physics_step": step,
            **to_plain({name: value for name, value in asdict(options).items() if name not in _MAY_CHANGE}),
        }
        found = Search(task, options, folder=folder, about=about, resume=resume, report=report).run()
        unknown = capture.object.mass is None and "mass" not in (*options.held, *options.names)
        drawn = torch.cat([found.posterior.z[None], found.posterior.kept])
        values = [coordinates.values(drawn, push) for push in range(len(forwards))]
        scale = find_mass_scale(forwards, values, options.seed) if unknown else None
    about = {**origin.to_provenance(), **registration_entry(written, X_WO)}
    twin = found_twin(capture, scene, found, options, surfels, camera_offset, mass, X_WO, about, q_WO=own[0].q)
    twin = with_mass(twin, scale)
    poses = [
        ObjectPoses(episode.t, X.p[: len(episode.t)].numpy(), X.q[: len(episode.t)].numpy())
        for episode, X in zip(pushes, found.poses, strict=True)
    ]
    return Identification(twin, found, poses)


def found_twin(
    capture: Capture,
    scene: Scene,
    found: Outcome,
    options: IdentifyOptions,
    surfels: Surfels,
    camera_offset: tuple[float, float],
    mass: float,
    X_WO: Pose,
    about: Mapping[str, Any],
    *,
    q_WO: Tensor,
) -> Twin:
    """Return the twin of an outcome, with its estimates; arguments are those of `identify_theta`.

    The mass [kg] is that for which inertias are given, X_WO the pose q (4,), p (3,) [m] of the object at rest, and
    `about` the entries of the provenance that tell where the twin is from; q_WO (4,) is the orientation in which it
    was pushed first.
    """
    coordinates = found.coordinates
    known = is_mass_known(capture, options)
    theta, nuisance = estimates(coordinates, found.posterior, scene, mass, known, options.seed)
    draws = kept_draws(coordinates, found.posterior, scene, mass)
    # The lift is told against the floor; the search counts it from where the capture has the object.
    extra = float(X_WO.p[2]) - resting_height(scene, X_WO.q)
    lift = nuisance["lift"]
    ends = None if lift.interval is None else (lift.interval[0] + extra, lift.interval[1] + extra)
    nuisance["lift"] = replace(lift, value=lift.value + extra, interval=ends)
    confused = confusion(draws, q_WO)
    if confused is not None:
        for name in ("frame_x", "frame_y", "center_x", "center_y"):
            nuisance[name] = replace(nuisance[name], note=confused.words)
    about = {
        **about,
        "seed": options.seed,
        "loss": found.loss,
        "coarse_losses": found.coarse_losses,
        "seconds": round(found.seconds, 2),
        "options": to_plain(asdict(options)),
    }
    if confused is not None:
        about["frame"] = asdict(confused) | {"note": confused.words}
    return assemble_twin(
        capture,
        surfels,
        camera_offset,
        theta,
        nuisance,
        about,
        lift=nuisance["lift"].value,
        time_step=scene.model.time_step,
        draws=draws,
        acts_as=scene.acts_as,
    )


def given_mass(capture: Capture, options: IdentifyOptions) -> float:
    """Mass [kg] for which inertias are given: the one that is held, that of the capture, or a nominal one."""
    return options.held.get("mass", capture.object.mass or NOMINAL_MASS)


def is_mass_known(capture: Capture, options: IdentifyOptions) -> bool:
    """Flag: the capture tells the mass, and none is held in its place."""
    return capture.object.mass is not None and "mass" not in options.held


def distinct_pushes(episodes: Episode | Sequence[Episode]) -> tuple[Episode, ...]:
    """Pushes that an identification is given; raises ParameterError where there is none, or one comes twice."""
    pushes = (episodes,) if isinstance(episodes, Episode) else tuple(episodes)
    names = [episode.name for episode in pushes]
    if not names or len(set(names)) < len(names):
        raise ParameterError(f"episodes are {names}; allowed: one or more, each once")
    return pushes


def capture_scene(capture: Capture, time_step: float, *, facets: bool = False) -> Scene:
    """Object, floor and pusher of a capture as the physics model of an identification, with its time step [s].

    With `facets` the object touches as its mesh, also where it acts as a primitive.

    Raises:
        InputError: A mesh cannot be used.
    """
    return make_scene(
        capture.object.mesh_path,
        capture.pusher,
        q_WO=capture.object.X_WO.q,
        gravity=capture.gravity,
        floor_height=capture.floor_height,
        time_step=time_step,
        support="patch",
        acts_as=() if facets else mesh_primitives(capture.object.mesh_path),
    )


def chosen_unknowns(
    capture: Capture, options: IdentifyOptions, scene: Scene, mass: float
) -> tuple[tuple[str, ...], dict[str, float]]:
    """Names of the free unknowns, and values of others; the spread of the pressure is held where it is chosen."""
    free, held = options.names, {"mass": mass, **options.held}
    if options.support != "auto":
        free = tuple(name for name in free if name not in SUPPORT)
        R_WO = quaternion_to_matrix(capture.object.X_WO.q).numpy()
        spread = (1.0, 1.0, 1.0)
        if options.support == "corners":
            spread = (1.0 / EVEN_SHARE,) * 3 if _lies_on_a_line(capture, scene) else corner_spread(scene.mesh, R_WO)
        held |= dict(zip(SUPPORT, spread, strict=True))
    return free, held


def _coordinates(
    capture: Capture,
    options: IdentifyOptions,
    scene: Scene,
    mass: float,
    starts: Sequence[Tensor],
    pushes: Sequence[Episode],
) -> Coordinates:
    """Return the unknowns.

    A camera is as far off as the object that it shows is away from where the static views have it; starts (3,) are what
    `find_start` found. Where the clock of a push was found, its offset is as sure as that is.
    """
    free, held = chosen_unknowns(capture, options, scene, mass)
    far = [float(d[:2].norm()) if bool((d.abs() <= LIMIT).all()) else 0.0 for d in starts]
    views = [{f"view_{axis}": max(UNKNOWNS[f"view_{axis}"].prior, one) for axis in "xyz"} for one in far]
    clocks = [{} if push.clock is None else {"time_offset": max(push.clock.deviation, _CLOCK)} for push in pushes]
    priors = [view | clock for view, clock in zip(views, clocks, strict=True)]
    return Coordinates(free, held, len(starts), priors, object_priors(capture, scene))


def object_priors(capture: Capture, scene: Scene) -> dict[str, float]:
    """Standard deviations of unknowns of the object that a capture tells.

    Its mesh is off by as much as the capture says. One that lies on a round side swings about its centre of mass, which
    is then no longer mistaken for an error of the frame: it may be far from that of a uniform solid.
    """
    found = {"contact_offset": math.hypot(UNKNOWNS["contact_offset"].prior, capture.object.mesh_error)}
    if _lies_on_a_line(capture, scene):
        found |= {f"center_{axis}": _CENTER_SHARE * half_diagonal(scene.mesh) for axis in "xyz"}
    return found


def _lies_on_a_line(capture: Capture, scene: Scene) -> bool:
    R_WO = quaternion_to_matrix(capture.object.X_WO.q).numpy()
    return any(abs(float(one.R_OG[:, 2] @ R_WO[2])) < LYING for one in scene.acts_as if one.kind in _LINES)


def _digest(surfels: Surfels) -> str:
    digest = hashlib.sha256()
    for name, tensor in sorted(surfels.tensors().items()):
        digest.update(name.encode() + tensor.detach().contiguous().numpy().tobytes())
    return digest.hexdigest()
