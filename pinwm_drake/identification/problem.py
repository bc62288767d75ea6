# SPDX-License-Identifier: MIT
"""The loss of W guesses of the unknowns: physics, rendering and comparison put together, for one push or several."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from pinwm_drake.geometry.meshes import half_diagonal
from pinwm_drake.identification.forward import Forward
from pinwm_drake.identification.image_loss import difference, squares
from pinwm_drake.identification.pictures import Pictures
from pinwm_drake.identification.unknowns import Coordinates
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose

# Guesses that are rendered at once: memory grows with it, speed hardly.
_TOGETHER = 4


@dataclass(frozen=True, eq=False)
class FilmedEpisode:
    """One push: the physics that is to explain its pictures."""

    forward: Forward  # The physics, with poses in the frames of the pictures
    pictures: Pictures  # n frames
    surfels: Surfels  # The object's appearance in their light, frame O

    @property
    def num_frames(self) -> int:
        """Number of frames n."""
        return len(self.pictures.color)


class Push(Protocol):
    """One push that is to be explained by the physics."""

    @property
    def forward(self) -> Forward:
        """Physics of the push."""

    @property
    def num_frames(self) -> int:
        """Number n of frames or poses."""


@dataclass(frozen=True, eq=False)
class Explained:
    """Model that is to explain one or more pushes of an object: unknowns and physics."""

    pushes: Sequence[Push]  # in the order of the unknowns' columns
    coordinates: Coordinates

    @property
    def radius(self) -> float:
        """Radius of the object [m]: half the diagonal of its mesh's box."""
        return half_diagonal(self.pushes[0].forward.scene.mesh)


@dataclass(frozen=True, eq=False)
class Problem(Explained):
    """Model that is to explain the videos of pushes: unknowns, physics and renderer."""

    pushes: tuple[FilmedEpisode, ...]
    num_threads: int  # of the renderer

    def frame_losses(self, z: Tensor, blocks: tuple[int, ...]) -> list[Tensor]:
        """Mean squares of every frame for W guesses.

        Args:
            z: (W, p).
            blocks: Sides of the blocks of pixels, px, as for `image_loss.squares`.

        Returns:
            For each push (n, W), differentiable in z but for `outline`; infinite where the physics found no solution.
        """
        found = []
        for number, push in enumerate(self.pushes):
            values = self.coordinates.values(z, number)
            X_WO, alive = push.forward.shown(values)
            parts = []
            for first in range(0, len(z), _TOGETHER):
                some = slice(first, first + _TOGETHER)
                X = Pose(X_WO.q[:, some], X_WO.p[:, some])
                outline = values["outline"][some].detach()
                images = difference(push.pictures, push.surfels, X, outline, num_threads=self.num_threads)
                parts.append(squares(images, blocks))
            found.append(torch.where(alive, torch.cat(parts, -1), torch.inf))
        return found

    @torch.no_grad()
    def fit_outline(self, z: Tensor) -> Tensor:
        """Unknowns z (W, p) with the outlines' scales that suit the first frames best, where these are free.

        The renderer widens what is small, so that each resolution has a scale of its own.
        """
        z = z.clone()
        for number, push in enumerate(self.pushes):
            columns = [k for k in self.coordinates.columns(number) if self.coordinates.free[k].name == "outline"]
            if not columns:
                continue
            first = push.pictures.some(torch.zeros(1, dtype=torch.long))
            X_WO = push.forward.X_WO
            guesses = torch.linspace(-25.0, 10.0, 36, dtype=torch.float64)
            trial = z[:1].expand(len(guesses), -1).clone()
            trial[:, columns[0]] = guesses
            outlines = self.coordinates.values(trial, number)["outline"]
            X = Pose(X_WO.q.expand(1, len(guesses), 4), X_WO.p.expand(1, len(guesses), 3))
            losses = squares(difference(first, push.surfels, X, outlines, num_threads=self.num_threads))[0]
            z[:, columns[0]] = guesses[int(losses.argmin())]
        return self.coordinates.clamp(z)
