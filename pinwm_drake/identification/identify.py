"""Identification of a twin from one push and an appearance: theta with intervals, by gradient through the images."""

import hashlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from pinwm_drake.capture.episodes import Episode, ObjectPoses, read_frames
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import Capture
from pinwm_drake.identification.forward import Forward
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.pictures import make_footage
from pinwm_drake.identification.problem import Problem
from pinwm_drake.identification.progress import Progress
from pinwm_drake.identification.search import Search
from pinwm_drake.identification.search_result import Found
from pinwm_drake.identification.uncertainty import estimates
from pinwm_drake.identification.unknowns import Coordinates
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.scene import Scene, Support, make_scene, resting_height
from pinwm_drake.twin.origin import Origin
from pinwm_drake.twin.plain_data import to_plain
from pinwm_drake.twin.twin import Estimate, Twin

# Options that a continued search may have otherwise; threads count with the number that is used.
_MAY_CHANGE = ("checkpoint_every", "num_threads")
_NOMINAL_MASS = 1.0  # kg, where none was measured


@dataclass(frozen=True, eq=False)
class Identification:
    """Identified twin, and the course of its identification.

    Attributes:
        twin: The twin; its provenance lacks entries that only the caller knows, such as the command.
        found: The search.
        poses: Poses of the object in the frames.
    """

    twin: Twin
    found: Found
    poses: ObjectPoses


def identify(
    capture: Capture,
    episode: Episode,
    surfels: Surfels,
    camera_offset: tuple[float, float],
    options: IdentifyOptions | None = None,
    *,
    folder: Path | None = None,
    resume: bool = False,
    report: Callable[[Progress], None] = lambda _: None,
) -> Identification:
    """Finds theta such that physics and renderer reproduce the video of a push.

    No pose is used: of the episode, camera, images, times and the pusher's trajectory.

    Args:
        capture: Object, pusher, floor, gravity.
        episode: The push.
        surfels: The object's appearance, frame O.
        camera_offset: px, added to the principal point of the episode's camera.
        options: Options of the search.
        folder: Folder of the checkpoints; None for none.
        resume: Whether to go on from a checkpoint in `folder`.
        report: Called after each step.

    Returns:
        The twin and the search.

    Raises:
        InputError: Images or meshes cannot be used, or a checkpoint is of another identification.
        SolverError: The physics found no solution.

    Source: PIN-WM (Li et al., 2025), eq. 8; deviations in `image_loss.py` and `search.py`.
    """
    options = options or IdentifyOptions()
    origin = Origin.of(capture, episode)
    number = options.threads
    mass = options.held.get("mass", capture.object.mass or _NOMINAL_MASS)
    coordinates = Coordinates(options.free, {"mass": mass, **options.held})
    images, masks = read_frames(episode)
    footage = make_footage(episode, images, masks, pusher_surface(capture.pusher), camera_offset)
    X_WO = capture.object.X_WO
    problems = {}
    for support in options.supports:
        forward = Forward(capture_scene(capture, options, support), episode, X_WO, mass, number)
        problems[support] = Problem(forward, surfels, coordinates, number)
    about = {
        "capture": origin.sha256,
        "episode": episode.name,
        "camera_offset": list(camera_offset),
        "surfels": _digest(surfels),
        "num_threads": number,
        **to_plain({name: value for name, value in asdict(options).items() if name not in _MAY_CHANGE}),
    }
    # The kernels bring their own threads, with which torch's, spinning between its calls, would compete.
    wide = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        search = Search(problems, footage, options, folder=folder, about=about, resume=resume, report=report)
        found = search.run()
    finally:
        torch.set_num_threads(wide)
    twin = _twin(capture, origin, surfels, camera_offset, options, coordinates, found, mass)
    q_WO, p_WO = found.poses
    return Identification(twin, found, ObjectPoses(episode.t, p_WO.numpy(), q_WO.numpy()))


def capture_scene(capture: Capture, options: IdentifyOptions, support: Support) -> Scene:
    """Object, floor and pusher of a capture as the physics model of an identification.

    Args:
        capture: The capture; its object lies as at the start of an episode.
        options: Time step and friction directions.
        support: Way in which the floor carries the object.

    Raises:
        InputError: A mesh cannot be used.
    """
    return make_scene(
        capture.object.mesh_path,
        capture.pusher,
        q_WO=capture.object.X_WO.q,
        gravity=capture.gravity,
        floor_height=capture.floor_height,
        time_step=options.time_step,
        friction_directions=options.friction_directions,
        support=support,
    )


def _twin(
    capture: Capture,
    origin: Origin,
    surfels: Surfels,
    camera_offset: tuple[float, float],
    options: IdentifyOptions,
    coordinates: Coordinates,
    found: Found,
    mass: float,
) -> Twin:
    """Twin from the result of a search."""
    scene = found.problem.forward.scene
    known = capture.object.mass is not None and "mass" not in options.held
    theta, nuisance = estimates(coordinates, found.posterior, scene, mass, known, options.seed)
    # The lift is told against the floor; the search counts it from where the capture has the object.
    extra = float(capture.object.X_WO.p[2]) - resting_height(scene, capture.object.X_WO.q)
    lift = nuisance["lift"]
    ends = None if lift.interval is None else (lift.interval[0] + extra, lift.interval[1] + extra)
    nuisance["lift"] = Estimate(lift.value + extra, ends, lift.identifiable, lift.unit, lift.note)
    return Twin(
        name=capture.object.name,
        mesh_path=capture.object.mesh_path,
        pusher=capture.pusher,
        gravity=capture.gravity,
        floor_height=capture.floor_height + nuisance["lift"].value,
        time_step=options.time_step,
        friction_directions=options.friction_directions,
        support=found.support,
        theta=theta,
        nuisance=nuisance,
        camera_offset=camera_offset,
        surfels=surfels,
        provenance={
            **origin.to_provenance(),
            "seed": options.seed,
            "loss": found.loss,
            "losses_by_support": {"coarse": found.coarse_losses, "final": found.losses},
            "dispersion": found.posterior.dispersion,
            "seconds": round(found.seconds, 2),
            "options": to_plain(asdict(options)),
        },
    )


def _digest(surfels: Surfels) -> str:
    digest = hashlib.sha256()
    for name, tensor in sorted(surfels.tensors().items()):
        digest.update(name.encode() + tensor.detach().contiguous().numpy().tobytes())
    return digest.hexdigest()
