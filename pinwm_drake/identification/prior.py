# SPDX-License-Identifier: MIT
"""Twin of an object that nothing has pushed yet: what the priors of an identification say."""

from pathlib import Path

import torch

from pinwm_drake.capture.scene import CAPTURE_FILE, Capture, load_capture
from pinwm_drake.errors import InputError
from pinwm_drake.identification.identify import (
    capture_scene,
    chosen_unknowns,
    given_mass,
    is_mass_known,
    object_priors,
)
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.posterior import KEPT, Posterior, estimates, kept_draws
from pinwm_drake.identification.time_step import LONGEST
from pinwm_drake.identification.unknowns import Coordinates
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.scene import resting_height
from pinwm_drake.twin.drift import FINE_DRIFTS
from pinwm_drake.twin.origin import registration_entry
from pinwm_drake.twin.twin import TWIN_FILE, Twin, assemble_twin


def capture_without_pushes(folder: Path) -> Capture | None:
    """Capture in a folder; None where it holds no capture, or a twin.

    Raises:
        InputError: The capture is refused, or has pushes.
    """
    if (folder / TWIN_FILE).is_file() or not (folder / CAPTURE_FILE).is_file():
        return None
    capture = load_capture(folder)
    if capture.episode_names:
        allowed = "a twin of them, which pinwm identify makes, or a capture without pushes"
        raise InputError(folder, value=f"a capture with pushes {', '.join(capture.episode_names)}", allowed=allowed)
    return capture


def prior_twin(capture: Capture, options: IdentifyOptions | None = None) -> Twin:
    """Twin of a capture without pushes, whose draws are of the priors that an identification begins with.

    It tells which push is worth filming first. It has no surfels, and is not meant to be written.

    Args:
        capture: Object with its mesh and pose, pusher, floor, gravity.
        options: Unknowns, support and seed of the identification; those of the search do not count.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: An unknown that there is not.
    """
    options = options or IdentifyOptions()
    scene = capture_scene(capture, options.time_step or LONGEST, facets=options.facets)
    mass = given_mass(capture, options)
    free, held = chosen_unknowns(capture, options, scene, mass)
    coordinates = Coordinates(free, held, 1, shared=object_priors(capture, scene))
    generator = torch.Generator().manual_seed(options.seed)
    draws = coordinates.draw_prior(KEPT, generator)
    even = torch.full((len(FINE_DRIFTS),), 1.0 / len(FINE_DRIFTS), dtype=torch.float64)
    posterior = Posterior.of(torch.zeros(len(coordinates), dtype=torch.float64), draws, even, generator)
    known = is_mass_known(capture, options)
    theta, nuisance = estimates(coordinates, posterior, scene, mass, known, options.seed)
    X_WO = capture.object.X_WO
    return assemble_twin(
        capture,
        _no_surfels(),
        (0.0, 0.0),
        theta,
        nuisance,
        registration_entry(X_WO, X_WO),
        lift=float(X_WO.p[2]) - resting_height(scene, X_WO.q),
        time_step=scene.model.time_step,
        draws=kept_draws(coordinates, posterior, scene, mass),
        acts_as=scene.acts_as,
    )


def _no_surfels() -> Surfels:
    shapes = ((0, 3), (0, 4), (0, 2), (0,), (0, 1, 3))
    return Surfels(*(torch.zeros(shape) for shape in shapes))
