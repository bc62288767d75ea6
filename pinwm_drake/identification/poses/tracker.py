# SPDX-License-Identifier: MIT
"""Tracker of the object in the video of a push: poses by the rendering loss alone, without physics.

It stands for the pose estimator that a laboratory has. Each frame begins where the poses before it lead, and
Levenberg-Marquardt lessens the mean square of rendering and picture on ever larger pictures. All six degrees of freedom
are free, after the first frame, in which the object rests as the capture says but for place and yaw.

Source: Nocedal and Wright, Numerical Optimization, section 10.3, on the expansion of `expansion.py`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.capture.episodes import Episode, ObjectPoses
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import Capture
from pinwm_drake.errors import require
from pinwm_drake.geometry.meshes import half_diagonal, load_mesh
from pinwm_drake.identification.expansion import corrected, deviation, expand
from pinwm_drake.identification.image_loss import BLOCKS, difference, squares
from pinwm_drake.identification.lighting import lit
from pinwm_drake.identification.locate import locate_start
from pinwm_drake.identification.pictures import Pictures, first_frames, make_pictures, read_footage
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.threads import available

# Shares of the largest size of pictures, on which poses are refined one after the other.
_SHARES = (0.25, 0.5, 1.0)
# Columns of an expansion that are free: in the first frame x, y, yaw and the outline; then the pose.
_START, _POSE = [3, 4, 2, 6], [0, 1, 2, 3, 4, 5]
_DAMPINGS = (0.1, 1.0, 10.0)
_FIRST_DAMPING, _MOST_DAMPING = 1e-2, 1e4
# A relative gain of the loss below this ends a descent.
_LEAST_GAIN = 1e-3
# Frames are of one moment where their times [s] round to the same.
_DECIMALS = 6


@dataclass(frozen=True)
class PoseTrackerOptions:
    """Settings of a tracker.

    Attributes:
        size: Longer side of the object in the largest pictures, px.
        steps: Steps of each descent at the most.
        num_threads: Threads of the renderer; None for one on each core.
    """

    size: float = 130.0
    steps: int = 12
    num_threads: int | None = None

    def __post_init__(self) -> None:
        """Raise ParameterError where a setting is out of its range."""
        require("size", self.size, 32.0 <= self.size <= 4096.0, "32 to 4096 px")
        require("steps", self.steps, 1 <= self.steps <= 1000, "1 to 1000")
        number = self.num_threads
        require("num_threads", number, number is None or number >= 1, "1 or more, or none")


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Track of an object through the video of a push."""

    poses: ObjectPoses  # Poses X_WO at the n times at which any camera took a frame
    # (n,), mean squares of rendering and pictures at these poses; not a number where no picture shows the
    # object, which then is taken to be where it was
    loss: np.ndarray


class PoseTracker:
    """Tracker of one object of known appearance."""

    def __init__(
        self,
        capture: Capture,
        surfels: Surfels,
        camera_offset: tuple[float, float],
        options: PoseTrackerOptions | None = None,
    ) -> None:
        """Read the meshes of object and pusher.

        Args:
            capture: Object, pusher, and the pose at the start of an episode.
            surfels: The object's appearance, frame O.
            camera_offset: px, added to the principal points of an episode's cameras.
            options: Settings; None for the default ones.

        Raises:
            InputError: A mesh cannot be used.
        """
        self.options = options or PoseTrackerOptions()
        self.X_WO, self.surfels, self.camera_offset = capture.object.X_WO, surfels, camera_offset
        self.pusher = pusher_surface(capture.pusher)
        self.radius = half_diagonal(load_mesh(capture.object.mesh_path))
        self._threads = self.options.num_threads or available()

    @torch.no_grad()
    def track(self, episode: Episode) -> PoseTrack:
        """Poses of the object in all frames of an episode; its own `object_poses` are not looked at.

        Args:
            episode: The push; frames that several cameras took at once are explained together.

        Raises:
            InputError: An image cannot be read, or the object is far from where the capture has it.
        """
        footage = read_footage(episode, self.pusher, self.camera_offset)
        start = locate_start(footage, self.surfels, self.X_WO, self.radius, num_threads=self._threads)
        first = first_frames(episode)
        pictures = [make_pictures(footage, share * self.options.size, together=False) for share in _SHARES]
        fine = pictures[-1].some(first)
        at = Pose(start.q.expand(len(first), 4), start.p.expand(len(first), 3))
        surfels = lit(fine, self.surfels, at, num_threads=self._threads)
        levels = []
        for some in pictures:
            outline = torch.ones((), dtype=torch.float64)
            start, outline, _ = self._descend(some.some(first), surfels, start, outline, _START)
            levels.append((some, outline))
        _, at_first, moment = np.unique(episode.times.round(_DECIMALS), return_index=True, return_inverse=True)
        t = episode.times[at_first]
        found: list[Pose] = []
        losses = np.full(len(t), np.nan)
        for number in range(len(t)):
            chosen = np.flatnonzero(moment == number)
            guesses = [*found[-1:], *_extrapolated(found, t[: number + 1])] or [start]
            X_WO = guesses[0]
            if any(footage.frames[k].pixels.size for k in chosen):
                X_WO, losses[number] = self._refined(levels, surfels, torch.from_numpy(chosen), guesses)
            found.append(X_WO)
        p, q = (torch.stack(part).numpy() for part in ([X.p for X in found], [X.q for X in found]))
        return PoseTrack(ObjectPoses(t, p, q), losses)

    def _refined(
        self, levels: Sequence[tuple[Pictures, Tensor]], surfels: Surfels, chosen: Tensor, guesses: Sequence[Pose]
    ) -> tuple[Pose, float]:
        """Pose that explains some frames (m,) of one moment, from the best of some guesses on, and its loss.

        Levels are pictures of one size each, with the outline's scale () that suits them.
        """
        pictures, outline = levels[0][0].some(chosen), levels[0][1]
        X = Pose(torch.stack([guess.q for guess in guesses]), torch.stack([guess.p for guess in guesses]))
        best = int(self._losses(pictures, surfels, X, outline.expand(len(guesses)), BLOCKS).argmin())
        X_WO, loss = guesses[best], np.nan
        for pictures, outline in levels:
            X_WO, _, loss = self._descend(pictures.some(chosen), surfels, X_WO, outline, _POSE)
        return X_WO, loss

    def _descend(
        self, pictures: Pictures, surfels: Surfels, X_WO: Pose, outline: Tensor, columns: list[int]
    ) -> tuple[Pose, Tensor, float]:
        """Pose, outline's scale () and loss after a descent in some columns of the expansion."""
        n, damping, model = len(pictures.color), _FIRST_DAMPING, None
        loss = np.inf
        for _ in range(self.options.steps):
            if model is None:
                at = Pose(X_WO.q.expand(n, 4), X_WO.p.expand(n, 3))
                model = expand(pictures, surfels, at, outline, self.radius, num_threads=self._threads)
                loss = float(model.loss.mean())
            H, g = model.curvature.mean(0)[columns][:, columns], model.gradient.mean(0)[columns]
            # What no pixel tells of stays as it is.
            scale = torch.diag(H.diagonal() + 1e-9)
            dampings = [damping * factor for factor in _DAMPINGS]
            d = torch.zeros(len(dampings), 7, dtype=torch.float64)
            d[:, columns] = torch.stack([torch.linalg.solve(H + one * scale, -g) for one in dampings])
            X = corrected(Pose(X_WO.q.expand(len(d), 4), X_WO.p.expand(len(d), 3)), d[:, :6])
            outlines = outline * d[:, 6].exp()
            losses = self._losses(pictures, surfels, X, outlines)
            best = int(losses.argmin())
            gain = loss - float(losses[best])
            if gain <= 0.0:
                damping *= 30.0
                if damping > _MOST_DAMPING:
                    break
                continue
            X_WO, outline, loss, model = Pose(X.q[best], X.p[best]), outlines[best], float(losses[best]), None
            damping = max(dampings[best], 1e-6)
            if gain < _LEAST_GAIN * loss:
                break
        return X_WO, outline, loss

    def _losses(
        self, pictures: Pictures, surfels: Surfels, X_WO: Pose, outlines: Tensor, blocks: tuple[int, ...] = (1,)
    ) -> Tensor:
        """Losses (W,) of poses q (W, 4), p (W, 3) with outlines' scales (W,), mean over the pictures."""
        n, W = len(pictures.color), len(X_WO.p)
        X = Pose(X_WO.q.expand(n, W, 4), X_WO.p.expand(n, W, 3))
        return squares(difference(pictures, surfels, X, outlines, num_threads=self._threads), blocks).mean(0)


def _extrapolated(found: Sequence[Pose], t: np.ndarray) -> list[Pose]:
    """Pose at the last of times t (k + 1,) [s] by the velocity between the last two of k poses; none before that."""
    if len(found) < 2:
        return []
    share = float((t[-1] - t[-2]) / (t[-2] - t[-3]))
    return [corrected(found[-1], share * deviation(found[-1], found[-2]))]
