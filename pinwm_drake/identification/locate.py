# SPDX-License-Identifier: MIT
"""Pose of a resting object from the first picture of an episode."""

import math

import torch
from torch import Tensor

from pinwm_drake.capture.episodes import Episode
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.errors import InputError
from pinwm_drake.geometry.meshes import half_diagonal, load_mesh
from pinwm_drake.identification.expansion import corrected, expand
from pinwm_drake.identification.image_loss import BLOCKS, difference, squares
from pinwm_drake.identification.lighting import lit
from pinwm_drake.identification.pictures import Footage, Pictures, first_frames, make_pictures, read_footage
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.threads import available
from pinwm_drake.twin.twin import Twin

# Longer sides of the object in the pictures, px: of the first search, and of the steps that follow it.
_SIZES = (32.0, 64.0, 130.0)
# Widths and steps of the search around the pose that is given: m, rad.
_REACH, _PLACE, _TURN = 2, 5e-3, math.radians(3.0)
# Changes that the search does not go beyond, but for a step: x, y [m], yaw [rad].
LIMIT = (_REACH + 1) * torch.tensor([_PLACE, _PLACE, _TURN], dtype=torch.float64)
_STEPS = 6
_RIDGE = 1e-3
# Guesses that are rendered at once.
_TOGETHER = 8


def locate(twin: Twin, episode: Episode, X_WO: Pose, *, num_threads: int | None = None) -> Pose:
    """Pose of the object in the first frame of an episode, on the floor and as upright as a given one.

    Args:
        twin: Mesh, pusher and appearance, and the offset of its capture's cameras.
        episode: Cameras and images; none but the first of each camera is read.
        X_WO: Where the object is about; q (4,), p (3,) [m].
        num_threads: Threads of the renderer; None for one on each core.

    Returns:
        X_WO; q (4,), p (3,) [m].

    Raises:
        InputError: An image cannot be read, or the object is farther than `LIMIT` from the given pose.
    """
    footage = read_footage(episode, pusher_surface(twin.pusher), twin.camera_offset, first_frames(episode))
    radius = half_diagonal(load_mesh(twin.mesh_path))
    return locate_start(footage, twin.surfels, X_WO, radius, num_threads=num_threads)


def locate_start(
    footage: Footage, surfels: Surfels, X_WO: Pose, radius: float, *, num_threads: int | None = None
) -> Pose:
    """Pose of the object in the first picture of each camera; arguments as for `find_start`, the rest as `locate`."""
    d = find_start(footage, surfels, X_WO, radius, num_threads=num_threads)
    if bool((d.abs() > LIMIT).any()):
        far = f"{1e3 * float(d[:2].norm()):.1f} mm and {math.degrees(abs(float(d[2]))):.1f}°"
        allowed = f"{1e3 * float(LIMIT[0]):g} mm and {math.degrees(float(LIMIT[2])):g}° at the most"
        folder = footage.episode.folder
        raise InputError(folder, value=f"an object {far} away from where it should be", allowed=allowed)
    return _moved(X_WO, d)


@torch.no_grad()
def find_start(
    footage: Footage, surfels: Surfels, X_WO: Pose, radius: float, *, num_threads: int | None = None
) -> Tensor:
    """Place and yaw for which renderings are nearest to the first picture of each camera.

    Args:
        footage: Frames of a push.
        surfels: The object's appearance, frame O.
        X_WO: Where the object is about; q (4,), p (3,) [m].
        radius: Of the object, m.
        num_threads: Threads of the renderer; None for one on each core.

    Returns:
        x, y [m] and yaw [rad] against the given pose, (3,); where an element is beyond `LIMIT`, the object was not
        found.
    """
    number, footage = num_threads or available(), footage.some(first_frames(footage.episode))
    outline = torch.ones((), dtype=torch.float64)
    d = torch.zeros(3, dtype=torch.float64)
    for turn, size in enumerate(_SIZES):
        pictures = make_pictures(footage, size, together=turn == 0)
        at = _frames(_moved(X_WO, d), len(footage.frames))
        shown = lit(pictures, surfels, at, num_threads=number)
        if turn == 0:
            d = _nearest(pictures, shown, X_WO, d, number)
            continue
        d, outline = _refined(pictures, shown, X_WO, d, outline, radius, number)
    return d


def _moved(X_WO: Pose, d: Tensor) -> Pose:
    """Poses with place and yaw changed by d (..., 3): x, y [m], yaw [rad]."""
    zero = torch.zeros_like(d[..., :1])
    moved = torch.cat([zero, zero, d[..., 2:], d[..., :2], zero], -1)
    return corrected(Pose(X_WO.q.expand(*d.shape[:-1], 4), X_WO.p.expand(*d.shape[:-1], 3)), moved)


def _frames(X_WO: Pose, n: int) -> Pose:
    return Pose(X_WO.q.expand(n, 4), X_WO.p.expand(n, 3))


def _nearest(pictures: Pictures, surfels: Surfels, X_WO: Pose, d: Tensor, num_threads: int) -> Tensor:
    """Return the best (3,) of a grid of changes around d."""
    steps = torch.arange(-_REACH, _REACH + 1, dtype=torch.float64)
    guesses = d + torch.cartesian_prod(_PLACE * steps, _PLACE * steps, _TURN * steps)
    n, losses = len(pictures.color), []
    for some in guesses.split(_TOGETHER):
        X = _moved(X_WO, some)
        X = Pose(X.q.expand(n, *X.q.shape), X.p.expand(n, *X.p.shape))
        outline = torch.ones(len(some), dtype=torch.float64)
        losses.append(squares(difference(pictures, surfels, X, outline, num_threads=num_threads), BLOCKS).mean(0))
    return guesses[int(torch.cat(losses).argmin())]


def _refined(
    pictures: Pictures, surfels: Surfels, X_WO: Pose, d: Tensor, outline: Tensor, radius: float, num_threads: int
) -> tuple[Tensor, Tensor]:
    """Change (3,) and outline () after some Gauss-Newton steps, of which each lessens the loss."""
    columns, n = [3, 4, 2, 6], len(pictures.color)
    best = None
    for _ in range(_STEPS):
        found = expand(pictures, surfels, _frames(_moved(X_WO, d), n), outline, radius, num_threads=num_threads)
        loss = float(found.loss.mean())
        if best is not None and loss >= best[0]:
            break
        best = (loss, d, outline)
        H = found.curvature.mean(0)[columns][:, columns]
        step = -torch.linalg.solve(H + _RIDGE * torch.diag(H.diagonal()), found.gradient.mean(0)[columns])
        d, outline = d + step[:3], outline * step[3].exp()
    assert best is not None
    return best[1], best[2]
